// The body inside of a closed surface of triangles, an STL file: put your own in its place.
DefineConstant[h = 0.02];

Merge "aeroplane.stl";
// Parts of the surface that meet at less than 40 degrees are smooth, and are meshed anew at size h.
ClassifySurfaces{40 * Pi / 180, 1, 1, Pi};
CreateGeometry;
Surface Loop(1) = Surface{:};
Volume(1) = {1};

Physical Surface("wall") = Surface{:};
Physical Volume("aeroplane") = {1};
Mesh.MeshSizeMin = h;
Mesh.MeshSizeMax = h;
Mesh.Optimize = 1;
