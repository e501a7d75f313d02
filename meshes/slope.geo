// Room around a slope: length L, width B, height H; the slope itself is filled with particles.
SetFactory("OpenCASCADE");
DefineConstant[h = 1];
DefineConstant[L = 35];
DefineConstant[B = 5];
DefineConstant[H = 6];

Box(1) = {0, 0, 0, L, B, H};

Physical Surface("back") = {1};
Physical Surface("front") = {2};
Physical Surface("sides") = {3, 4};
Physical Surface("bottom") = {5};
Physical Surface("top") = {6};
Physical Volume("room") = {1};
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
Mesh.Optimize = 1;
Mesh.OptimizeThreshold = 0.7;
