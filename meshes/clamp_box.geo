// Box [-12, 12] x [-11, 11] cut by the line through the origin that is turned by `angle` (degrees) from
// the vertical: a cantilever can be clamped there at any angle, while the box stays where it is. The
// middle of the cut, 4 long, is meshed alike at all angles.
SetFactory("OpenCASCADE");
DefineConstant[h = 0.5];
DefineConstant[angle = 0];

a = angle * Pi / 180;
t = 11 * Tan(a);
Point(1) = {t, -11, 0};
Point(2) = {12, -11, 0};
Point(3) = {12, 11, 0};
Point(4) = {-t, 11, 0};
Point(5) = {-2 * Sin(a), 2 * Cos(a), 0};
Point(6) = {2 * Sin(a), -2 * Cos(a), 0};
Line(1) = {1, 2};
Line(2) = {2, 3};
Line(3) = {3, 4};
Line(4) = {4, 5};
Line(5) = {5, 6};
Line(6) = {6, 1};
Curve Loop(1) = {1 : 6};
Plane Surface(1) = {1};

Physical Curve("clamp") = {4, 5, 6};
Physical Curve("sides") = {1, 2, 3};
Physical Surface("box") = {1};
Mesh.Algorithm = 5;
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
