// The band of this workgroup: gl_WorkGroupID.y. Bands of other parts have no cells here.

readonly buffer Bands {
  Band bands[];
};

Band band = bands[gl_WorkGroupID.y];
bool band_here = band.origin.w == int(push.part);

// Cells of a box of this band, with a margin.
ivec2 cells_of(ivec3 extent) { return run_of(0, band_here ? extent.x * extent.y * extent.z : 0); }
// Its unknowns.
ivec2 unknowns_of_band() { return run_of(band.places.x, band_here ? band.places.y : band.places.x); }

ivec3 box_origin() { return band.origin.xyz; }
ivec3 box_extent() { return band.extent.xyz; }
