/* Keeps the meshes of the stream as libfacet-client has them, for check-godot: FOLDER/SEQUENCE.f32, vertices
 * in mm, then normals. Says "frame SEQUENCE" for each; ends with the server, or when it is ended. Usage:
 * keep_frames SOCKET displacements|vertices FOLDER */

#include <facet-client.h>
#include <stdio.h>
#include <string.h>

int main(int argc, char** argv) {
  const facet_mesh* mesh;
  if (argc != 4) {
    return 2;
  }
  facet_client* client = facet_client_new(
      argv[1], strcmp(argv[2], "vertices") == 0 ? FACET_VERTICES : FACET_DISPLACEMENTS, 0, "keep_frames");
  while (client != NULL && facet_client_next(client, -1) == FACET_OK) {
    if (facet_client_mesh(client, &mesh) != FACET_OK) {
      continue;
    }
    const unsigned long sequence = (unsigned long)facet_client_frame(client)->sequence;
    const size_t count = 3 * (size_t)mesh->vertex_count;
    char path[4096];
    snprintf(path, sizeof(path), "%s/%lu.f32", argv[3], sequence);
    FILE* file = fopen(path, "wb");
    if (file == NULL || fwrite(mesh->vertices_mm, sizeof(float), count, file) != count ||
        fwrite(mesh->normals, sizeof(float), count, file) != count || fclose(file) != 0) {
      perror(path);
      return 1;
    }
    printf("frame %lu\n", sequence);
    fflush(stdout);
  }
  facet_client_free(client);
  return 0;
}
