// Channel of 0.255 x 0.157 x 0.04 with a round nozzle of 4.62 mm in its floor (y = 0) at x = 0.03, z = 0.
// cells: edges across the nozzle; growth: size gained per distance from the jet; size: edges far from it.
// Groups: INLET 1, OUTLET 2, FLOOR 3, SIDES 4, NOZZLE 5, FLUID 10.
DefineConstant[ cells = 4, growth = 0.14, size = 0.006 ];
SetFactory("OpenCASCADE");
l = 0.255; h = 0.157; w = 0.04; x0 = 0.03; d = 0.00462; r = d / 2; e = 1e-6;
Box(1) = {0, 0, -w / 2, l, h, w};
Disk(100) = {x0, 0, 0, r};
Rotate {{1, 0, 0}, {x0, 0, 0}, Pi / 2} { Surface{100}; }
BooleanFragments{ Volume{1}; Delete; }{ Surface{100}; Delete; }
inlet() = Surface In BoundingBox{-e, -e, -w, e, h + e, w};
outlet() = Surface In BoundingBox{l - e, -e, -w, l + e, h + e, w};
nozzle() = Surface In BoundingBox{x0 - r - e, -e, -r - e, x0 + r + e, e, r + e};
floor() = Surface In BoundingBox{-e, -e, -w, l + e, e, w}; floor() -= nozzle();
sides() = Surface In BoundingBox{-e, h - e, -w, l + e, h + e, w};
sides() += Surface In BoundingBox{-e, -e, -w / 2 - e, l + e, h + e, -w / 2 + e};
sides() += Surface In BoundingBox{-e, -e, w / 2 - e, l + e, h + e, w / 2 + e};
Physical Surface("INLET", 1) = inlet(); Physical Surface("OUTLET", 2) = outlet(); Physical Surface("FLOOR", 3) = floor();
Physical Surface("SIDES", 4) = sides(); Physical Surface("NOZZLE", 5) = nozzle(); Physical Volume("FLUID", 10) = {1};
// the distance from a segment that rises from the nozzle, half as long downstream
Field[1] = MathEval;
Field[1].F = Sprintf("min(%g, %g + %g * Max(0, sqrt((Max(0, %g - x) + 0.35 * Max(0, x - %g))^2 + z^2 + Max(0, y - 0.02)^2) - %g))", size, d / cells, growth, x0, x0, r);
Background Field = 1;
Mesh.MeshSizeExtendFromBoundary = 0; Mesh.MeshSizeFromPoints = 0; Mesh.MeshSizeFromCurvature = 0;
Mesh.Algorithm = 6; Mesh.Algorithm3D = 1; Mesh.Optimize = 1;
