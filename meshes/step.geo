// Channel [0, W] x [0, H] with a step of height S that begins at x = X and goes on to the end.
SetFactory("OpenCASCADE");
DefineConstant[h = 0.05];
DefineConstant[W = 3];
DefineConstant[H = 1];
DefineConstant[X = 0.6];
DefineConstant[S = 0.2];

Point(1) = {0, 0, 0};
Point(2) = {X, 0, 0};
Point(3) = {X, S, 0};
Point(4) = {W, S, 0};
Point(5) = {W, H, 0};
Point(6) = {0, H, 0};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 5};
Line(5) = {5, 6};
Line(6) = {6, 1};
Curve Loop(1) = {1 : 6};
Plane Surface(1) = {1};

Physical Curve("bottom") = {1, 2, 3};
Physical Curve("right") = {4};
Physical Curve("top") = {5};
Physical Curve("left") = {6};
Physical Surface("channel") = {1};
Mesh.Algorithm = 5;
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
