/* Shows the live face of a running facetd in a window, drawn by SDL 2 (libsdl2-dev):
 * cc view.c $(pkg-config --cflags --libs facet-client sdl2) -lm
 * Usage: view [SOCKET [PICTURE.bmp]]       PICTURE.bmp: keeps the first face as a picture and ends */
#include <SDL.h>
#include <facet-client.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#define SHOWN_MM 300.0F /* of the head in the window's shorter side */

struct triangle {
  float depth_mm;
  const uint32_t* corners;
};

struct drawing {
  SDL_Vertex* vertices; /* [vertex_count] */
  float* depths_mm;     /* [vertex_count] from the head's origin, away from the camera */
  struct triangle* triangles;
  int* corners; /* of those that are seen, far to near */
};

static int further(const void* a, const void* b) {
  const float one = ((const struct triangle*)a)->depth_mm;
  const float other = ((const struct triangle*)b)->depth_mm;
  return (one < other) - (one > other);
}

static int make_room(struct drawing* drawing, const facet_subject* subject) {
  const size_t vertices = subject->vertex_count;
  const size_t triangles = subject->triangle_count;
  free(drawing->vertices);
  free(drawing->depths_mm);
  free(drawing->triangles);
  free(drawing->corners);
  drawing->vertices = calloc(vertices, sizeof(SDL_Vertex));
  drawing->depths_mm = calloc(vertices, sizeof(float));
  drawing->triangles = calloc(triangles, sizeof(struct triangle));
  drawing->corners = calloc(3 * triangles, sizeof(int));
  return drawing->vertices != NULL && drawing->depths_mm != NULL && drawing->triangles != NULL &&
         drawing->corners != NULL;
}

static Uint8 shade(float linear) {
  return (Uint8)(255.0F * sqrtf(fminf(fmaxf(linear, 0.0F), 1.0F))); /* about sRGB */
}

/* As the camera sees the head, held in the middle. Camera: x right, y down, z forward. */
static void place_vertices(struct drawing* drawing, const facet_frame* frame, const facet_mesh* mesh,
                           const facet_albedo* albedo, int width, int height) {
  const float scale = (float)(width < height ? width : height) / SHOWN_MM;
  const int coloured =
      albedo != NULL && albedo->subject_id == frame->subject_id && albedo->vertex_count == mesh->vertex_count;
  for (size_t v = 0; v < mesh->vertex_count; ++v) {
    float at[3];
    float normal[3];
    for (size_t row = 0; row < 3; ++row) {
      const float* turn = frame->camera_from_head[row];
      const float* point = mesh->vertices_mm + 3 * v;
      const float* direction = mesh->normals + 3 * v;
      at[row] = turn[0] * point[0] + turn[1] * point[1] + turn[2] * point[2];
      normal[row] = turn[0] * direction[0] + turn[1] * direction[1] + turn[2] * direction[2];
    }
    const float light = 0.15F + 0.85F * fmaxf(-normal[2], 0.0F);
    float skin[3] = {0.6F, 0.6F, 0.6F};
    for (size_t c = 0; coloured && c < 3; ++c) {
      skin[c] = albedo->scale / 65535.0F * (float)albedo->linear_rgb[3 * v + c];
    }
    SDL_Vertex* vertex = &drawing->vertices[v];
    vertex->position.x = 0.5F * (float)width + scale * at[0];
    vertex->position.y = 0.5F * (float)height + scale * at[1];
    vertex->color.r = shade(light * skin[0]);
    vertex->color.g = shade(light * skin[1]);
    vertex->color.b = shade(light * skin[2]);
    vertex->color.a = 255;
    drawing->depths_mm[v] = at[2];
  }
}

/* Those that face the camera, far ones first. Returns how many corners they have. */
static int order_triangles(struct drawing* drawing, const facet_subject* subject) {
  size_t seen = 0;
  for (size_t t = 0; t < subject->triangle_count; ++t) {
    const uint32_t* corners = subject->triangles + 3 * t;
    const SDL_FPoint a = drawing->vertices[corners[0]].position;
    const SDL_FPoint b = drawing->vertices[corners[1]].position;
    const SDL_FPoint c = drawing->vertices[corners[2]].position;
    /* Counter-clockwise from outside; y points down here. */
    if ((b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x) < 0.0F) {
      const float* depths_mm = drawing->depths_mm;
      drawing->triangles[seen].depth_mm =
          depths_mm[corners[0]] + depths_mm[corners[1]] + depths_mm[corners[2]];
      drawing->triangles[seen++].corners = corners;
    }
  }
  qsort(drawing->triangles, seen, sizeof(struct triangle), further);
  for (size_t t = 0; t < seen; ++t) {
    for (size_t k = 0; k < 3; ++k) {
      drawing->corners[3 * t + k] = (int)drawing->triangles[t].corners[k];
    }
  }
  return (int)(3 * seen);
}

static int keep_picture(SDL_Renderer* renderer, const char* file) {
  int width = 0;
  int height = 0;
  SDL_GetRendererOutputSize(renderer, &width, &height);
  SDL_Surface* picture = SDL_CreateRGBSurfaceWithFormat(0, width, height, 24, SDL_PIXELFORMAT_BGR24);
  const int kept =
      picture != NULL &&
      SDL_RenderReadPixels(renderer, NULL, SDL_PIXELFORMAT_BGR24, picture->pixels, picture->pitch) == 0 &&
      SDL_SaveBMP(picture, file) == 0;
  SDL_FreeSurface(picture);
  return kept;
}

int main(int argc, char** argv) {
  const char* picture = argc > 2 ? argv[2] : NULL;
  facet_client* client = facet_client_new(argc > 1 ? argv[1] : NULL, FACET_DISPLACEMENTS,
                                          FACET_WANT_RING | FACET_WANT_ALBEDO | FACET_RECONNECT, "view");
  SDL_Window* window = NULL;
  SDL_Renderer* renderer = NULL;
  if (client == NULL || SDL_Init(SDL_INIT_VIDEO) != 0 ||
      SDL_CreateWindowAndRenderer(720, 720, SDL_WINDOW_RESIZABLE, &window, &renderer) != 0) {
    fprintf(stderr, "view: %s\n",
            client == NULL ? "no client: is the socket's path too long?" : SDL_GetError());
    facet_client_free(client);
    SDL_Quit();
    return 1;
  }
  struct drawing drawing = {NULL, NULL, NULL, NULL};
  uint64_t shown = 0; /* subject; another one has other triangles */
  int status = 0;
  for (int running = 1; running;) {
    for (SDL_Event event; SDL_PollEvent(&event) != 0;) {
      running = running && event.type != SDL_QUIT;
    }
    const facet_mesh* mesh = NULL;
    const int outcome = facet_client_next(client, 10); /* waits no longer, so that the window answers */
    if (outcome != FACET_OK || facet_client_mesh(client, &mesh) != FACET_OK) {
      SDL_SetWindowTitle(window, outcome == FACET_OK ? "no face" : facet_client_message(client));
      if (outcome != FACET_OK && outcome != FACET_TIMEOUT) {
        fprintf(stderr, "view: %s\n", facet_client_message(client));
        status = 1;
        running = 0;
      }
      continue;
    }
    const facet_frame* frame = facet_client_frame(client);
    const facet_subject* subject = facet_client_subject(client);
    if (frame->subject_id != shown && !make_room(&drawing, subject)) {
      fprintf(stderr, "view: no memory for a mesh\n");
      status = 1;
      break;
    }
    shown = frame->subject_id;
    int width = 0;
    int height = 0;
    SDL_GetRendererOutputSize(renderer, &width, &height);
    place_vertices(&drawing, frame, mesh, facet_client_albedo(client), width, height);
    const int corners = order_triangles(&drawing, subject);
    SDL_SetRenderDrawColor(renderer, 23, 29, 38, 255);
    SDL_RenderClear(renderer);
    SDL_RenderGeometry(renderer, NULL, drawing.vertices, (int)mesh->vertex_count, drawing.corners, corners);
    if (picture != NULL) {
      status = keep_picture(renderer, picture) ? 0 : 1;
      running = 0;
    }
    SDL_RenderPresent(renderer);
    SDL_SetWindowTitle(window, "Facet");
  }
  free(drawing.vertices);
  free(drawing.depths_mm);
  free(drawing.triangles);
  free(drawing.corners);
  facet_client_free(client);
  SDL_DestroyRenderer(renderer);
  SDL_DestroyWindow(window);
  SDL_Quit();
  return status;
}
