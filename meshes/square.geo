// Unit square with an irregular Delaunay mesh.
SetFactory("OpenCASCADE");
DefineConstant[h = 0.1];

Rectangle(1) = {0, 0, 0, 1, 1};

Physical Curve("bottom") = {1};
Physical Curve("right") = {2};
Physical Curve("top") = {3};
Physical Curve("left") = {4};
Physical Surface("square") = {1};
Mesh.Algorithm = 5;
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
