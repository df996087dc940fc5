/* Writes the first mesh of a running facetd as OBJ: cc write_obj.c $(pkg-config --cflags --libs facet-client)
 * Usage: write_obj SOCKET FILE.obj */
#include <facet-client.h>
#include <stdio.h>

static int write_mesh(FILE* file, const facet_subject* subject, const facet_mesh* mesh) {
  for (size_t v = 0; v < mesh->vertex_count; ++v) {
    const float* at = mesh->vertices_mm + 3 * v;
    const float* normal = mesh->normals + 3 * v;
    const float* uv = subject->texture_coordinates + 2 * v;
    fprintf(file, "v %.9g %.9g %.9g\nvt %.9g %.9g\nvn %.9g %.9g %.9g\n", (double)at[0], (double)at[1],
            (double)at[2], (double)uv[0], (double)uv[1], (double)normal[0], (double)normal[1],
            (double)normal[2]);
  }
  for (size_t t = 0; t < subject->triangle_count; ++t) {
    const unsigned i = subject->triangles[3 * t] + 1;
    const unsigned j = subject->triangles[3 * t + 1] + 1;
    const unsigned k = subject->triangles[3 * t + 2] + 1;
    fprintf(file, "f %u/%u/%u %u/%u/%u %u/%u/%u\n", i, i, i, j, j, j, k, k, k);
  }
  return ferror(file) == 0;
}

int main(int argc, char** argv) {
  if (argc != 3) {
    fprintf(stderr, "usage: write_obj SOCKET FILE.obj\n");
    return 2;
  }
  facet_client* client = facet_client_new(argv[1], FACET_DISPLACEMENTS, FACET_WANT_RING, "write_obj");
  const facet_mesh* mesh = NULL;
  int outcome = client != NULL ? FACET_OK : FACET_OUT_OF_MEMORY;
  while (mesh == NULL && (outcome == FACET_OK || outcome == FACET_TIMEOUT)) {
    outcome = facet_client_next(client, 1000);
    if (outcome == FACET_OK) {
      facet_client_mesh(client, &mesh); /* stays NULL where the frame has no mesh */
    }
  }
  FILE* file = mesh != NULL ? fopen(argv[2], "w") : NULL;
  const int written = file != NULL && write_mesh(file, facet_client_subject(client), mesh);
  if (file == NULL || fclose(file) != 0 || !written) {
    fprintf(stderr, "write_obj: %s: no mesh was written: %s\n", argv[2],
            client != NULL ? facet_client_message(client) : "no client");
    facet_client_free(client);
    return 1;
  }
  facet_client_free(client);
  return 0;
}
