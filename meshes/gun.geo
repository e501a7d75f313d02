// Barrel of length B and bore D, closed at x = 0, that opens into a room [B, W] x [-H/2, H/2]. With S > 0 the room
// begins behind a silencer: a chamber of length S and height C, whose end of thickness T is as wide open as the bore.
// "barrel" is what a bullet slides along, "front" the other walls.
SetFactory("OpenCASCADE");
DefineConstant[h = 0.025];
DefineConstant[W = 4];
DefineConstant[H = 1];
DefineConstant[B = 1];
DefineConstant[D = 0.15];
DefineConstant[S = 0];
DefineConstant[C = 0.5];
DefineConstant[T = 0.1];

d = D / 2;
x[] = {0, B};
y[] = {d, d};
If (S > 0)
  x[] += {B, B + S, B + S, B + S + T};
  y[] += {C / 2, C / 2, d, d};
EndIf
n = #x[];
For i In {0 : n - 1}
  Point(1 + i) = {x[i], -y[i], 0};
  Point(101 + i) = {x[i], y[i], 0};
EndFor
Point(51) = {x[n - 1], -H / 2, 0};
Point(52) = {W, -H / 2, 0};
Point(152) = {W, H / 2, 0};
Point(151) = {x[n - 1], H / 2, 0};
For i In {1 : n - 1}
  Line(i) = {i, i + 1};
  Line(100 + i) = {100 + i, 101 + i};
EndFor
Line(n) = {n, 51};
Line(100 + n) = {100 + n, 151};
Line(51) = {51, 52};
Line(52) = {52, 152};
Line(151) = {151, 152};
Line(150) = {1, 101};
Curve Loop(1) = {1 : n, 51, 52, -151, -(100 + n) : -101, -150};
Plane Surface(1) = {1};

If (S > 0)
  Physical Curve("barrel") = {1, 5, 101, 105, 150};
  Physical Curve("front") = {2 : 4, 6, 102 : 104, 106};
Else
  Physical Curve("barrel") = {1, 101, 150};
  Physical Curve("front") = {2, 102};
EndIf
Physical Curve("open") = {51, 52, 151};
Physical Surface("gas") = {1};
Mesh.Algorithm = 5;
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
