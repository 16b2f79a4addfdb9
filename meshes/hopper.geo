// Flat silo with a wedge-shaped hopper and a slot: width x depth, vertical part, converging part, slot. Groups: OUTLET 2 (the
// slot at the bottom), WALL 3 (front, back and sides), TOP 4 (open top), FLUID 10 (volume).
DefineConstant[ width = 0.1, depth = 0.015, bin = 0.12, cone = 0.06, slot = 0.02, size = 0.015 ];
SetFactory("Built-in");
a = (width - slot) / 2;
Point(1) = {a, 0, 0, size}; Point(2) = {a + slot, 0, 0, size}; Point(3) = {width, 0, cone, size};
Point(4) = {width, 0, cone + bin, size}; Point(5) = {0, 0, cone + bin, size}; Point(6) = {0, 0, cone, size};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 5}; Line(5) = {5, 6}; Line(6) = {6, 1};
Curve Loop(1) = {1, 2, 3, 4, 5, 6}; Plane Surface(1) = {1};
out[] = Extrude {0, depth, 0} { Surface{1}; };
Physical Surface("OUTLET", 2) = {out[2]};
Physical Surface("TOP", 4) = {out[5]};
Physical Surface("WALL", 3) = {1, out[0], out[3], out[4], out[6], out[7]};
Physical Volume("FLUID", 10) = {out[1]};
Mesh.Optimize = 1;
