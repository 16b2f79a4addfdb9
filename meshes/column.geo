// Cylindrical column along z. Groups: INLET 1 (bottom), OUTLET 2 (top), WALL 3, FLUID 10 (volume).
DefineConstant[ radius = 0.01385, height = 0.04, size = 0.003 ];
SetFactory("OpenCASCADE");
Cylinder(1) = {0, 0, 0, 0, 0, height, radius};
MeshSize{ PointsOf{ Volume{1}; } } = size;
Mesh.MeshSizeMax = size;
Physical Surface("WALL", 3) = {1};
Physical Surface("OUTLET", 2) = {2};
Physical Surface("INLET", 1) = {3};
Physical Volume("FLUID", 10) = {1};
Mesh.Optimize = 1;
