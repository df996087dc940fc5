// vec4 values that lighting_sums leaves for lighting_solve.
const uint kLightingSums = 22;
