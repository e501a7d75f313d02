// Ball of radius 0.5 around the origin.
SetFactory("OpenCASCADE");
DefineConstant[h = 0.1];

Sphere(1) = {0, 0, 0, 0.5};

Physical Surface("wall") = {1};
Physical Volume("ball") = {1};
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
Mesh.Optimize = 1;
Mesh.OptimizeThreshold = 0.7;
