// Whether a number is one. By its bits: compilers may take it for granted that values are numbers, and then
// comparisons, min, max and clamp turn what is none into one.
bool is_finite(float value) {
  return (floatBitsToUint(value) & 0x7f800000u) != 0x7f800000u;
}

const uint kNotANumberBits = 0x7fc00000u;
