#version 460

// Decides on the device how many workgroups the next step starts.

layout(local_size_x = 1) in;

readonly buffer Wanted { uint wanted[]; };
writeonly buffer Counts { uint counts[]; };

void main() {
  counts[0] = wanted[0];
  counts[1] = 1;
  counts[2] = 1;
}
