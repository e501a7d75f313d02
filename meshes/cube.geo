// Unit cube.
SetFactory("OpenCASCADE");
DefineConstant[h = 0.2];

Box(1) = {0, 0, 0, 1, 1, 1};

Physical Surface("walls") = {1 : 6};
Physical Volume("cube") = {1};
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
Mesh.Optimize = 1;
Mesh.OptimizeThreshold = 0.7;
