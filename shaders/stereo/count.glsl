// How many unknowns there are.

readonly buffer UnknownCount {
  int unknown_count;
};
