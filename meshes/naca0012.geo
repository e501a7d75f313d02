// Square [-R, R]^2 around a NACA 0012 airfoil of chord 1, its nose at the origin and its tail closed.
// h: cells along its middle; a quarter of that at the nose, half at the tail, and growing by G per length.
SetFactory("OpenCASCADE");
DefineConstant[h = 0.02];
DefineConstant[R = 10];
DefineConstant[G = 0.15];

n = 60;
For i In {0 : 2 * n - 1}
    x = 0.5 * (1 + Cos(Pi * i / n));
    y = 0.6 * (0.2969 * Sqrt(x) - 0.126 * x - 0.3516 * x^2 + 0.2843 * x^3 - 0.1036 * x^4);
    If (i > n)
        y = -y;
    EndIf
    If (i == 0)
        y = 0;
    EndIf
    Point(1 + i) = {x, y, 0};
EndFor
Spline(1) = {1 : n + 1};
Spline(2) = {n + 1 : 2 * n, 1};
Point(1001) = {-R, -R, 0};
Point(1002) = {R, -R, 0};
Point(1003) = {R, R, 0};
Point(1004) = {-R, R, 0};
Line(1001) = {1001, 1002};
Line(1002) = {1002, 1003};
Line(1003) = {1003, 1004};
Line(1004) = {1004, 1001};
Curve Loop(1) = {1001 : 1004};
Curve Loop(2) = {1, 2};
Plane Surface(1) = {1, 2};

Physical Curve("airfoil") = {1, 2};
Physical Curve("left") = {1004};
Physical Curve("outer") = {1001, 1002, 1003};
Physical Surface("air") = {1};

Field[1] = Distance;
Field[1].CurvesList = {1, 2};
Field[1].NumPointsPerCurve = 400;
Field[2] = Distance;
Field[2].PointsList = {n + 1};
Field[3] = MathEval;
Field[3].F = Sprintf("%g + %g * F1", h, G);
Field[4] = MathEval;
Field[4].F = Sprintf("%g + %g * F2", h / 4, G);
Field[5] = Distance;
Field[5].PointsList = {1};
Field[6] = MathEval;
Field[6].F = Sprintf("%g + %g * F5", h / 2, G);
Field[7] = Min;
Field[7].FieldsList = {3, 4, 6};
Background Field = 7;
Mesh.Algorithm = 5;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
