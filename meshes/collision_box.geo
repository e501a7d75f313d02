// Box [0, 1]^2 in which two bodies collide.
SetFactory("OpenCASCADE");
DefineConstant[h = 0.05];

Rectangle(1) = {0, 0, 0, 1, 1};

Physical Curve("walls") = {1, 2, 3, 4};
Physical Surface("box") = {1};
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
