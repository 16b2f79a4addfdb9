// Channel of 2.2 x 0.41 with a cylinder of radius 0.05 at (0.2, 0.2), after Schaefer and Turek (1996).
// around: segments on the cylinder; size: edges far away; growth: size gained per distance from the cylinder.
// Groups: INLET 1, OUTLET 2, WALLS 3, CYLINDER 4, FLUID 10.
DefineConstant[ around = 64, size = 0.04, growth = 0.1 ];
r = 0.05; h = 2 * Pi * r / around;
Point(1) = {0, 0, 0}; Point(2) = {2.2, 0, 0}; Point(3) = {2.2, 0.41, 0}; Point(4) = {0, 0.41, 0}; Point(5) = {0.2, 0.2, 0};
Point(6) = {0.2 + r, 0.2, 0}; Point(7) = {0.2, 0.2 + r, 0}; Point(8) = {0.2 - r, 0.2, 0}; Point(9) = {0.2, 0.2 - r, 0};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Circle(5) = {6, 5, 7}; Circle(6) = {7, 5, 8}; Circle(7) = {8, 5, 9}; Circle(8) = {9, 5, 6};
Transfinite Curve {5, 6, 7, 8} = around / 4 + 1;
Curve Loop(1) = {1, 2, 3, 4}; Curve Loop(2) = {5, 6, 7, 8}; Plane Surface(1) = {1, 2};
Physical Curve("INLET", 1) = {4}; Physical Curve("OUTLET", 2) = {2}; Physical Curve("WALLS", 3) = {1, 3};
Physical Curve("CYLINDER", 4) = {5, 6, 7, 8}; Physical Surface("FLUID", 10) = {1};
Field[1] = MathEval;
Field[1].F = Sprintf("min(%g, %g + %g * Max(0, sqrt((x-0.2)^2+(y-0.2)^2) - 0.05))", size, h, growth);
Background Field = 1;
Mesh.MeshSizeExtendFromBoundary = 0; Mesh.MeshSizeFromPoints = 0; Mesh.MeshSizeFromCurvature = 0;
Mesh.Algorithm = 6;
