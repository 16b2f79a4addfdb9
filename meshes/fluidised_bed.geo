// Rectangular bed: width x depth x height, cells of one size. Groups: INLET 1 (bottom), OUTLET 2 (top), WALL 3 (depth
// direction front and back and the sides), FLUID 10 (volume).
DefineConstant[ width = 0.15, depth = 0.015, height = 0.45, size = 0.0075 ];
SetFactory("Built-in");
Point(1) = {0, 0, 0, size}; Point(2) = {width, 0, 0, size}; Point(3) = {width, depth, 0, size}; Point(4) = {0, depth, 0, size};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4}; Plane Surface(1) = {1};
out[] = Extrude {0, 0, height} { Surface{1}; };
Physical Surface("INLET", 1) = {1};
Physical Surface("OUTLET", 2) = {out[0]};
Physical Surface("WALL", 3) = {out[2], out[3], out[4], out[5]};
Physical Volume("FLUID", 10) = {out[1]};
Mesh.Optimize = 1;
