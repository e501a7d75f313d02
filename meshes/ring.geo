// Ring of outer radius 1 and inner radius R around the origin.
SetFactory("OpenCASCADE");
DefineConstant[h = 0.1];
DefineConstant[R = 0.75];

Disk(1) = {0, 0, 0, 1};
Disk(2) = {0, 0, 0, R};
BooleanDifference(3) = { Surface{1}; Delete; }{ Surface{2}; Delete; };

Physical Curve("wall") = Boundary{ Surface{3}; };
Physical Surface("ring") = {3};
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
