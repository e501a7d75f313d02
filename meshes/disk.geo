// Disk of radius 1 around the origin.
SetFactory("OpenCASCADE");
DefineConstant[h = 0.1];

Disk(1) = {0, 0, 0, 1};

Physical Curve("wall") = {1};
Physical Surface("disk") = {1};
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
