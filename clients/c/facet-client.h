#ifndef FACET_CLIENT_H
#define FACET_CLIENT_H

/* libfacet-client: the live meshes of a running facetd, in C11 with nothing but libc. facet-client(3) is its
 * manual, docs/stream-protocol.md what it speaks. A client belongs to one thread at a time. Pointers that a
 * client gives are its own and stay valid until the next call of facet_client_next or facet_client_free.
 * Structs only ever grow at their end: they are made by the library alone.
 *
 * Head frame: x to the subject's left, y up, z out of the face. Camera frame: x right, y down, z forward.
 * Both mm. */

#include <stddef.h>
#include <stdint.h>

#if defined(__GNUC__)
#define FACET_API __attribute__((visibility("default")))
#else
#define FACET_API
#endif

#ifdef __cplusplus
extern "C" {
#endif

#define FACET_DEFAULT_SOCKET "/run/facet/stream.sock"

typedef struct facet_client facet_client;

/* How much of a frame comes. */
enum {
  FACET_SIGNALS = 0,       /* state, pose, expression, lighting: no geometry */
  FACET_DISPLACEMENTS = 1, /* and the mesh, compact: facet_client_mesh rebuilds it */
  FACET_VERTICES = 2 /* and the finest vertices and normals: nothing to rebuild, about four times the bytes */
};

enum {
  FACET_WANT_ALBEDO = 1,
  FACET_WANT_RING = 2, /* through shared memory where the server offers it, else over the socket */
  FACET_RECONNECT = 4  /* a server that is not there, or no longer, is waited for */
};

enum {
  FACET_OK = 0,
  FACET_TIMEOUT = 1,     /* no frame within the time given; call again */
  FACET_UNAVAILABLE = 2, /* nobody answers at the socket, or this user may not connect to it */
  FACET_CLOSED = 3,      /* the server said goodbye or is gone */
  FACET_BAD_DATA =
      4, /* what came breaks the protocol, or is of another version; the connection is given up */
  FACET_OVERWRITTEN = 5, /* the frame was overwritten in the ring while it was read; call facet_client_next */
  FACET_NO_MESH = 6,     /* the frame has none */
  FACET_OUT_OF_MEMORY = 7
};

enum { FACET_SEARCHING = 0, FACET_ACQUIRING = 1, FACET_TRACKING = 2, FACET_LOST = 3 };
/* What a frame shows: what the cameras see; a recorded take; a face that somebody poses or animates. */
enum { FACET_LIVE = 0, FACET_TAKE = 1, FACET_POSE = 2 };

/* Fixed point: value = values[k] * step_mm. In a frame that comes through a ring, values lie in shared memory
 * that is overwritten some frames later: what was made of them counts only where facet_client_intact says so
 * after. */
typedef struct facet_fixed_point {
  const int16_t* values; /* [count] NULL: not there */
  size_t count;
  float step_mm;
} facet_fixed_point;

typedef struct facet_frame {
  uint64_t sequence;
  int64_t timestamp_ns; /* CLOCK_MONOTONIC, start of the exposure */
  int64_t media_time_ns;
  int32_t state; /* FACET_SEARCHING ... */
  int32_t degraded;
  const char* degraded_reason; /* never NULL */
  float fx, fy, cx, cy;        /* of the camera, px */
  int32_t width_px, height_px;
  const float* landmarks_px; /* [landmark_count][2] */
  size_t landmark_count;
  float reprojection_px;
  float latency_ms; /* from the frame's delivery to the mesh's hand-out */

  uint64_t subject_id;          /* 0: no mesh, and nothing below is there */
  uint64_t albedo_version;      /* 0: none yet */
  float camera_from_head[3][4]; /* p_camera = camera_from_head * p_head, mm */
  const float* expression;      /* [expression_count] 0 to 1, as facet_subject names them */
  size_t expression_count;
  float photometric_rms;
  float lighting[9]; /* spherical harmonics, camera frame with y up and z towards the camera */

  facet_fixed_point control_vertices; /* FACET_DISPLACEMENTS: [control_vertex_count][3] head frame */
  facet_fixed_point displacements;    /* FACET_DISPLACEMENTS: [vertex_count] */
  facet_fixed_point vertices;         /* FACET_VERTICES: [vertex_count][3] head frame */
  const int16_t* normals;             /* FACET_VERTICES: [vertex_count][3] unit normals, 32767 is 1 */
  const uint8_t* confidence;          /* [vertex_count] 255 is 1; NULL: not there */
  int32_t in_ring;                    /* 1: normals, confidence and values lie in shared memory */

  const uint8_t* expression_confidence; /* [expression_count] 255 is 1: how far a value can be believed; NULL:
                                           not known */
  int32_t origin;                       /* FACET_LIVE ... */

  const float* avatar_values; /* [expression_count] 0 to 1: what an avatar is to be moved by: expression
                                 counted from the person's neutral pose and tuned by name, where the server
                                 knows one; else expression itself */
  float
      upright_position_m[3]; /* where the head is: x to the picture's right, y up, z towards the camera, m */
  float upright_rotation[4]; /* x y z w of the unit quaternion that turns the head frame into these axes */
} facet_frame;

/* The triangles of one level of detail: over the first vertex_count vertices of the finest mesh. */
typedef struct facet_level {
  uint32_t vertex_count;
  uint32_t triangle_count;
  const uint32_t* triangles; /* [triangle_count][3] counter-clockwise from outside */
} facet_level;

/* What does not change from frame to frame. */
typedef struct facet_subject {
  uint64_t id;
  const char* const* expression_names; /* [expression_count] */
  size_t expression_count;
  const float* identity; /* [identity_count] standard deviations */
  size_t identity_count;
  uint32_t control_vertex_count;    /* FACET_DISPLACEMENTS, else 0 */
  uint32_t vertex_count;            /* of the finest level; 0 with FACET_SIGNALS */
  uint32_t triangle_count;          /* of the finest level */
  const uint32_t* triangles;        /* [triangle_count][3] counter-clockwise from outside */
  const float* texture_coordinates; /* [vertex_count][2] u right, v up */
  const char* person;               /* whose enrolled shape is followed; NULL: nobody was named */
  const float* neutral_mm;          /* [control_vertex_count][3] the face at rest, head frame; NULL: it is the
                                       model's of this identity, or not FACET_DISPLACEMENTS */
  const facet_level* levels;        /* [level_count] coarse to fine; the last is the finest */
  uint32_t level_count;             /* 0 with FACET_SIGNALS */
} facet_subject;

typedef struct facet_albedo {
  uint64_t subject_id;
  uint64_t version;
  float scale;                /* linear value of 65535 */
  const uint16_t* linear_rgb; /* [vertex_count][3] */
  size_t vertex_count;
} facet_albedo;

/* The finest mesh of a frame, head frame. */
typedef struct facet_mesh {
  uint32_t vertex_count;
  const float* vertices_mm; /* [vertex_count][3] */
  const float* normals;     /* [vertex_count][3] unit length */
} facet_mesh;

typedef struct facet_statistics {
  uint64_t received;    /* frames */
  uint64_t dropped;     /* frames that came while this client was busy, over all connections */
  uint64_t overwritten; /* of a ring, while they were read */
  uint64_t connections;
  uint64_t bytes;  /* over the socket */
  int32_t by_ring; /* 1: frames come through shared memory now */
} facet_statistics;

/* Makes a client; it connects with the first facet_client_next.
 *
 * socket   path; NULL or "": what FACET_SOCKET of the environment names, else FACET_DEFAULT_SOCKET
 * profile  FACET_SIGNALS, FACET_DISPLACEMENTS or FACET_VERTICES
 * flags    FACET_WANT_ALBEDO and so on, added
 * name     for people, in the server's statistics; 64 bytes of it at most; NULL: "libfacet-client"
 * returns  NULL where memory is out, or with errno EINVAL where an argument is wrong (path too long, unknown
 * profile) */
FACET_API facet_client* facet_client_new(const char* socket, int profile, unsigned flags, const char* name);
/* NULL is allowed. */
FACET_API void facet_client_free(facet_client* client);

/* Waits for the newest frame that this client has not had yet, connecting first where needed.
 *
 * timeout_ms  0: what is there already; below 0: without end
 * returns     FACET_OK: facet_client_frame is it. FACET_TIMEOUT. Without FACET_RECONNECT also
 * FACET_UNAVAILABLE and FACET_CLOSED. FACET_BAD_DATA, FACET_OUT_OF_MEMORY: the connection is closed; the next
 * call makes a new one. Of whatever is not FACET_OK, facet_client_message tells the reason. */
FACET_API int facet_client_next(facet_client* client, int timeout_ms);
/* For people; never NULL. */
FACET_API const char* facet_client_message(const facet_client* client);

/* NULL where there is none. The subject and the albedo are the newest that came; a frame's are those whose id
 * and version it names. */
FACET_API const facet_frame* facet_client_frame(const facet_client* client);
FACET_API const facet_subject* facet_client_subject(const facet_client* client);
FACET_API const facet_albedo* facet_client_albedo(const facet_client* client);

/* A value of the frame by its name.
 *
 * name     as facet_subject has it: "jawOpen" and so on, ARKit's
 * returns  0 to 1; NAN where there is no frame, the frame has no face, or its model has no such expression */
FACET_API float facet_client_expression(const facet_client* client, const char* name);
/* The same of avatar_values. */
FACET_API float facet_client_avatar_value(const facet_client* client, const char* name);

/* The finest mesh of the frame: rebuilt (coarse mesh through the levels' stencils, vertex + displacement *
 * unit normal; [MD19 sec. 4.3]) or scaled. The memory is the client's.
 *
 * returns  FACET_OK, FACET_NO_MESH, FACET_OVERWRITTEN, FACET_OUT_OF_MEMORY; `mesh` is set with FACET_OK alone
 */
FACET_API int facet_client_mesh(facet_client* client, const facet_mesh** mesh);

/* 1: nothing that was read of the frame's arrays so far was overwritten; always so over the socket. */
FACET_API int facet_client_intact(const facet_client* client);

FACET_API const facet_statistics* facet_client_statistics(const facet_client* client);
/* Of the library, such as "0.1.0". */
FACET_API const char* facet_client_version(void);

#ifdef __cplusplus
}
#endif

#endif
