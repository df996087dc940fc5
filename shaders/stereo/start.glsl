// Start values by semi-global matching [Hir08] of some slots at once. The CPU's way is daemon/stereo/start_value.cpp.

layout(push_constant) uniform Push {
  StartPush push;
};
readonly buffer Centres {
  int centres[];  // slots whose start values are wanted; -1: none
};
readonly buffer Usable {
  float usable[];  // [slots] 0: the slot has no picture, or none with a pattern
};

// The centre of this workgroup's slot of the chunk, or -1.
int centre_of(int in_chunk) { return centres[push.volume.w + in_chunk]; }
bool speaks(int slot) { return slot >= 0 && slot < push.volume.z && usable[slot] > 0; }
int pixels() { return push.volume.x * push.volume.y; }
// Slots of a window, and images of the chunk: [chunk][window][2 views][y][x].
int window() { return 2 * push.reach + 1; }
int image_of(int in_chunk, int near, int view) { return ((in_chunk * window() + near) * 2 + view) * pixels(); }
