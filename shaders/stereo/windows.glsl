// Reach of a window to each side: 4, 2, 2 for the paper's 9 x 5 x 5.
layout(constant_id = 0) const int radius_x = 4;
layout(constant_id = 1) const int radius_y = 2;
layout(constant_id = 2) const int radius_t = 2;

ivec3 radius() { return ivec3(radius_x, radius_y, radius_t); }

// A sample that says nothing: all its products vanish, and it is not counted.
const float kNoSample = -1e15;
