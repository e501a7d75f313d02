// Strip of length 30 and height H, for bars and waves along x.
SetFactory("OpenCASCADE");
DefineConstant[h = 0.5];
DefineConstant[H = 1];

Rectangle(1) = {0, 0, 0, 30, H};

Physical Curve("sides") = {1, 3};
Physical Curve("right") = {2};
Physical Curve("left") = {4};
Physical Surface("bar") = {1};
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
