// Box [-W/2, W/2] x [0, H] above a nozzle of width D in the middle of its floor; cells four times as wide
// outside of the column above it.
SetFactory("OpenCASCADE");
DefineConstant[h = 0.01];
DefineConstant[W = 1];
DefineConstant[H = 1];
DefineConstant[D = 0.125];

Point(1) = {-W / 2, 0, 0};
Point(2) = {-D / 2, 0, 0};
Point(3) = {D / 2, 0, 0};
Point(4) = {W / 2, 0, 0};
Point(5) = {W / 2, H, 0};
Point(6) = {-W / 2, H, 0};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 5};
Line(5) = {5, 6};
Line(6) = {6, 1};
Curve Loop(1) = {1 : 6};
Plane Surface(1) = {1};

Physical Curve("floor") = {1, 3};
Physical Curve("nozzle") = {2};
Physical Curve("open") = {4, 5, 6};
Physical Surface("box") = {1};

Field[1] = Box;
Field[1].VIn = h;
Field[1].VOut = 4 * h;
Field[1].XMin = -1.2 * D;
Field[1].XMax = 1.2 * D;
Field[1].YMin = 0;
Field[1].YMax = H;
Field[1].Thickness = D;
Background Field = 1;
Mesh.Algorithm = 5;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
