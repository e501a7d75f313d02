// Stellated octahedron (star tetrahedron, Metatron's star) around the origin, its eight tips at
// distance R: the union of two tetrahedra whose corners are those of a cube.
SetFactory("OpenCASCADE");
DefineConstant[h = 0.05];
DefineConstant[R = 0.3];

a = R / Sqrt(3);
For k In {0 : 1}
  s = 1 - 2 * k;
  p = 4 * k;
  Point(p + 1) = {s * a, s * a, s * a};
  Point(p + 2) = {s * a, -s * a, -s * a};
  Point(p + 3) = {-s * a, s * a, -s * a};
  Point(p + 4) = {-s * a, -s * a, s * a};
  e = 6 * k;
  Line(e + 1) = {p + 1, p + 2};
  Line(e + 2) = {p + 1, p + 3};
  Line(e + 3) = {p + 1, p + 4};
  Line(e + 4) = {p + 2, p + 3};
  Line(e + 5) = {p + 3, p + 4};
  Line(e + 6) = {p + 4, p + 2};
  f = 4 * k;
  Curve Loop(f + 1) = {e + 1, e + 4, -(e + 2)};
  Curve Loop(f + 2) = {e + 2, e + 5, -(e + 3)};
  Curve Loop(f + 3) = {e + 3, e + 6, -(e + 1)};
  Curve Loop(f + 4) = {e + 4, e + 5, e + 6};
  For i In {1 : 4}
    Plane Surface(f + i) = {f + i};
  EndFor
  Surface Loop(k + 1) = {f + 1 : f + 4};
  Volume(k + 1) = {k + 1};
EndFor
BooleanUnion(3) = { Volume{1}; Delete; }{ Volume{2}; Delete; };

Physical Surface("wall") = Boundary{ Volume{3}; };
Physical Volume("star") = {3};
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
Mesh.Optimize = 1;
Mesh.OptimizeThreshold = 0.7;
