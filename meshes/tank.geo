// Rectangular tank of width W and height H, its lower left corner at (x0, y0), irregular inside.
SetFactory("OpenCASCADE");
DefineConstant[h = 0.1];
DefineConstant[W = 2];
DefineConstant[H = 1];
DefineConstant[x0 = 0];
DefineConstant[y0 = 0];

Rectangle(1) = {x0, y0, 0, W, H};

Physical Curve("bottom") = {1};
Physical Curve("right") = {2};
Physical Curve("top") = {3};
Physical Curve("left") = {4};
Physical Surface("tank") = {1};
Mesh.Algorithm = 5;
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
