#ifndef FACET_CLIENT_REBUILD_H
#define FACET_CLIENT_REBUILD_H

#include "wire.h"

/* Memory of a finest mesh; grows, and is used again. Zero to begin with. */
struct mesh_memory {
  float* positions[2]; /* level by level in turns */
  float* normals;
  size_t vertex_count; /* that there is room for */
};

/* The finest mesh of a frame, the same numbers as mesh::rebuild_finest and stream::decode_frame make of it.
 *
 * returns  FACET_OK, FACET_NO_MESH or FACET_OUT_OF_MEMORY */
int rebuild_mesh(const facet_frame* frame, const struct wire_subject* subject, struct mesh_memory* memory,
                 facet_mesh* out);
void rebuild_free(struct mesh_memory* memory);

#endif
