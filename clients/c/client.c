#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "address.h"
#include "buffer.h"
#include "rebuild.h"
#include "ring.h"
#include "wire.h"

enum { PASSED_DESCRIPTORS = 2, RING_ATTEMPTS = 64, FIRST_PAUSE_MS = 50, LONGEST_PAUSE_MS = 2000 };
/* After its deadline a call still takes what has come; from a server that never pauses no longer than this.
 */
enum { GRACE_MS = 100 };

struct facet_client {
  struct sockaddr_un address;
  int profile;
  unsigned flags;
  char name[WIRE_MAX_NAME_BYTES + 1];

  int fd; /* -1: not connected */
  int subscribed;
  int64_t late_ms;  /* when a call ends though the server sends on and on */
  int64_t heard_ms; /* when the last frame came, or the connection was made */
  int64_t retry_ms; /* when to connect again */
  int pause_ms;
  uint8_t header[WIRE_HEADER_BYTES];
  size_t header_filled;
  size_t announced; /* bytes of the message that is coming */
  struct buffer incoming;
  int passed[PASSED_DESCRIPTORS];
  int passed_count;
  uint64_t dropped_told; /* by the server, over this connection */

  struct ring ring;
  int ring_head_waits; /* the newest frame's head is known, its subject is not */
  struct buffer frame_message;
  struct buffer subject_message;
  struct buffer albedo_message;
  int has_frame;
  int has_subject;
  int has_albedo;
  facet_frame frame;
  struct wire_subject subject;
  facet_albedo albedo;
  struct mesh_memory mesh_memory;
  facet_mesh mesh;
  facet_statistics statistics;
  char message[256];
};

/* What a step of the work came to, beside the outcomes of the interface. */
enum { AGAIN = -1 };

static int64_t now_ms(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

__attribute__((format(printf, 2, 3))) static void say(facet_client* client, const char* format, ...) {
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(client->message, sizeof(client->message), format, arguments);
  va_end(arguments);
}

static void close_descriptor(int* fd) {
  if (*fd >= 0) {
    close(*fd);
  }
  *fd = -1;
}

static void drop_passed(facet_client* client) {
  while (client->passed_count > 0) {
    close_descriptor(&client->passed[--client->passed_count]);
  }
}

static void drop_ring(facet_client* client) {
  if (client->ring.memory != NULL) {
    munmap(client->ring.memory, client->ring.bytes);
    client->ring.memory = NULL;
    close_descriptor(&client->ring.wake);
  }
  client->ring_head_waits = 0;
  client->has_frame = client->has_frame && !client->frame.in_ring;
  client->statistics.by_ring = 0;
}

/* Ends the connection; what came over it is of no subject that a next one sends. */
static void hang_up(facet_client* client) {
  close_descriptor(&client->fd);
  drop_passed(client);
  drop_ring(client);
  client->subscribed = 0;
  client->header_filled = 0;
  client->incoming.size = 0;
  client->dropped_told = 0;
  client->ring.number = 0;
  client->has_frame = 0;
  client->has_subject = 0;
  client->has_albedo = 0;
  client->retry_ms = now_ms() + client->pause_ms;
  client->pause_ms = client->pause_ms * 2 < LONGEST_PAUSE_MS ? client->pause_ms * 2 : LONGEST_PAUSE_MS;
}

static int lost(facet_client* client, int outcome) {
  hang_up(client);
  return (client->flags & FACET_RECONNECT) != 0 && outcome != FACET_BAD_DATA && outcome != FACET_OUT_OF_MEMORY
             ? AGAIN
             : outcome;
}

static int bad_data(facet_client* client, const char* what) {
  say(client, "'%s' breaks the stream protocol: %s", client->address.sun_path, what);
  return lost(client, FACET_BAD_DATA);
}

static int late(const facet_client* client) {
  return now_ms() >= client->late_ms;
}

/* the socket */

static int connect_now(facet_client* client) {
  client->fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  if (client->fd < 0 ||
      connect(client->fd, (const struct sockaddr*)&client->address, sizeof(client->address)) != 0) {
    if (client->fd >= 0 && errno == EAGAIN) { /* its queue is full: it is there, and may accept yet */
      say(client, "the server at '%s' does not answer", client->address.sun_path);
      hang_up(client);
      return AGAIN;
    }
    address_trouble(&client->address, errno, client->message, sizeof(client->message));
    return lost(client, FACET_UNAVAILABLE);
  }
  ++client->statistics.connections;
  client->heard_ms = now_ms();
  return FACET_OK;
}

static int subscribe(facet_client* client) {
  uint8_t message[WIRE_HEADER_BYTES + WIRE_MAX_SUBSCRIBE_BYTES];
  const uint32_t magic = WIRE_MAGIC;
  const uint32_t ring_version = (client->flags & FACET_WANT_RING) != 0 ? FACET_RING_VERSION : 0;
  const uint32_t length =
      (uint32_t)wire_subscribe(message + WIRE_HEADER_BYTES, client->profile,
                               (client->flags & FACET_WANT_ALBEDO) != 0, client->name, ring_version);
  memcpy(message, &magic, 4);
  memcpy(message + 4, &length, 4);
  client->subscribed = 1;
  /* The socket's buffer is empty: a request goes as a whole or not at all. */
  if (send(client->fd, message, WIRE_HEADER_BYTES + length, MSG_NOSIGNAL) !=
      (ssize_t)(WIRE_HEADER_BYTES + length)) {
    say(client, "the connection to '%s' broke: %s", client->address.sun_path, strerror(errno));
    return lost(client, FACET_CLOSED);
  }
  return AGAIN;
}

static void take_descriptors(facet_client* client, struct msghdr* message) {
  for (struct cmsghdr* header = CMSG_FIRSTHDR(message); header != NULL;
       header = CMSG_NXTHDR(message, header)) {
    if (header->cmsg_level != SOL_SOCKET || header->cmsg_type != SCM_RIGHTS) {
      continue;
    }
    const size_t count = (header->cmsg_len - CMSG_LEN(0)) / sizeof(int);
    drop_passed(client); /* of one message at most */
    for (size_t k = 0; k < count; ++k) {
      int fd = -1;
      memcpy(&fd, CMSG_DATA(header) + k * sizeof(int), sizeof(int));
      if (client->passed_count < PASSED_DESCRIPTORS) {
        client->passed[client->passed_count++] = fd;
      } else {
        close(fd);
      }
    }
  }
}

/* recv() of at most `size` bytes with the descriptors beside them; AGAIN where there is nothing. */
static int receive_some(facet_client* client, uint8_t* out, size_t size, size_t* received) {
  union {
    char bytes[CMSG_SPACE(PASSED_DESCRIPTORS * sizeof(int))];
    struct cmsghdr align;
  } control;
  struct iovec part = {out, size};
  struct msghdr message;
  memset(&message, 0, sizeof(message));
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  message.msg_control = control.bytes;
  message.msg_controllen = sizeof(control.bytes);
  const ssize_t count = recvmsg(client->fd, &message, MSG_DONTWAIT | MSG_CMSG_CLOEXEC);
  if (count < 0 && (errno == EAGAIN || errno == EINTR)) {
    return AGAIN;
  }
  if (count <= 0) {
    say(client, "the server at '%s' is gone: %s", client->address.sun_path,
        count == 0 ? "it closed the connection" : strerror(errno));
    return FACET_CLOSED;
  }
  take_descriptors(client, &message);
  client->statistics.bytes += (uint64_t)count;
  *received = (size_t)count;
  return FACET_OK;
}

/* Reads what is there up to the end of a message. FACET_OK: `incoming` is one. AGAIN: wait for more. */
static int receive_message(facet_client* client) {
  struct buffer* incoming = &client->incoming;
  for (;;) {
    size_t received = 0;
    int outcome;
    if (client->header_filled < WIRE_HEADER_BYTES) {
      outcome = receive_some(client, client->header + client->header_filled,
                             WIRE_HEADER_BYTES - client->header_filled, &received);
      client->header_filled += received;
      if (outcome == FACET_OK && client->header_filled == WIRE_HEADER_BYTES) {
        uint32_t magic;
        uint32_t length;
        memcpy(&magic, client->header, 4);
        memcpy(&length, client->header + 4, 4);
        if (magic != WIRE_MAGIC) {
          return bad_data(client, "its messages have another magic: is it another socket?");
        }
        if (length > WIRE_MAX_MESSAGE_BYTES) {
          return bad_data(client, "a message is longer than 64 MiB");
        }
        client->announced = length;
        incoming->size = 0;
      }
    } else {
      if (!buffer_grow(incoming, client->announced)) {
        say(client, "no memory for a message of %zu bytes", client->announced);
        return lost(client, FACET_OUT_OF_MEMORY);
      }
      size_t part = client->announced < incoming->room ? client->announced : incoming->room;
      part -= incoming->size;
      outcome = part > 0 ? receive_some(client, incoming->bytes + incoming->size, part, &received) : FACET_OK;
      incoming->size += received;
      if (outcome == FACET_OK && incoming->size == client->announced) {
        client->header_filled = 0;
        return FACET_OK;
      }
    }
    if (outcome == FACET_CLOSED) {
      return lost(client, FACET_CLOSED);
    }
    if (outcome != FACET_OK || late(client)) {
      return outcome != FACET_OK ? outcome : AGAIN;
    }
  }
}

static void keep(facet_client* client, struct buffer* kept) {
  const struct buffer other = *kept;
  *kept = client->incoming;
  client->incoming = other;
  client->incoming.size = 0;
}

/* the ring */

static int open_ring(facet_client* client, uint32_t version) {
  struct ring* ring = &client->ring;
  struct facet_ring_page page;
  struct stat status;
  drop_ring(client);
  if (version != FACET_RING_VERSION || client->passed_count != PASSED_DESCRIPTORS) {
    return bad_data(client, "a ring of another version, or without its descriptors");
  }
  /* Memory that its owner may shorten kills its readers (SIGBUS). */
  const int seals = fcntl(client->passed[0], F_GET_SEALS);
  if (seals < 0 || (seals & F_SEAL_SHRINK) == 0 || fstat(client->passed[0], &status) != 0) {
    return bad_data(client, "a ring whose memory is not sealed");
  }
  /* The page first: no more is mapped than it says, and it may not say more than the limits. */
  if (pread(client->passed[0], &page, offsetof(struct facet_ring_page, published), 0) !=
          (ssize_t)offsetof(struct facet_ring_page, published) ||
      page.magic != FACET_RING_MAGIC || page.version != FACET_RING_VERSION || page.slot_count < 2 ||
      page.slot_count > FACET_RING_MAX_SLOTS || page.slot_bytes < sizeof(struct facet_ring_slot) ||
      page.slot_bytes % FACET_RING_ALIGNMENT != 0 || page.slot_bytes > WIRE_MAX_MESSAGE_BYTES) {
    return bad_data(client, "a ring whose page makes no sense");
  }
  /* In blocks, too: what is not there yet would become this process's memory when it is read. */
  const uint64_t bytes = FACET_RING_PAGE_BYTES + page.slot_count * page.slot_bytes;
  if ((uint64_t)status.st_size < bytes || (uint64_t)status.st_blocks * 512 < bytes) {
    return bad_data(client, "a ring whose memory is not all there");
  }
  if (fstat(client->passed[1], &status) != 0 || !S_ISFIFO(status.st_mode)) {
    return bad_data(client, "a ring whose wake-ups come through no pipe");
  }
  void* memory = mmap(NULL, (size_t)bytes, PROT_READ, MAP_SHARED, client->passed[0], 0);
  if (memory == MAP_FAILED) {
    say(client, "no memory for a ring: %s", strerror(errno));
    return lost(client, FACET_OUT_OF_MEMORY);
  }
  ring->memory = memory;
  ring->bytes = (size_t)bytes;
  ring->wake = client->passed[1];
  client->passed_count = 1;
  drop_passed(client);
  fcntl(ring->wake, F_SETFL, O_NONBLOCK);
  ring->slot_count = page.slot_count;
  ring->slot_bytes = page.slot_bytes;
  ring->publication = 0;
  client->statistics.by_ring = 1;
  return AGAIN;
}

/* The newest frame's head into frame_message. FACET_OK, AGAIN: there is nothing new, or what lost() says. */
static int newest_head(facet_client* client) {
  struct ring* ring = &client->ring;
  struct facet_ring_slot slot;
  for (int attempt = 0; attempt < RING_ATTEMPTS; ++attempt) {
    const uint64_t publication = ring_published(ring);
    __atomic_thread_fence(__ATOMIC_ACQUIRE);
    if (publication == 0 || publication == ring->publication) {
      return AGAIN;
    }
    client->ring_head_waits = 0;
    const int copied = ring_copy_head(ring, publication, &slot, &client->frame_message);
    if (copied < 0) {
      say(client, "no memory for a frame");
      return lost(client, FACET_OUT_OF_MEMORY);
    }
    if (copied == 0) {
      continue;
    }
    static const size_t number_bytes[FACET_RING_ARRAY_COUNT] = {2, 2, 2, 2, 1};
    int sound = slot.head_bytes == client->frame_message.size;
    for (int k = 0; k < FACET_RING_ARRAY_COUNT; ++k) {
      sound = sound && slot.arrays[k].offset % FACET_RING_ALIGNMENT == 0 &&
              (slot.arrays[k].offset == 0) == (slot.arrays[k].count == 0) &&
              slot.arrays[k].offset + slot.arrays[k].count * number_bytes[k] <= ring->slot_bytes;
    }
    if (!sound) {
      return bad_data(client, "a frame of the ring lies outside of its slot");
    }
    ring->publication = publication;
    ring->slot = slot;
    return FACET_OK;
  }
  return AGAIN;
}

static int next_of_ring(facet_client* client) {
  struct ring* ring = &client->ring;
  struct wire_array arrays[FACET_RING_ARRAY_COUNT];
  char wake_ups[64];
  /* First the wake-ups, then the frame: one that comes in between wakes again. A server that sends them
   * without end is not waited for; nor one that took O_NONBLOCK away from its pipe. */
  struct pollfd woken = {ring->wake, POLLIN, 0};
  if (poll(&woken, 1, 0) > 0 && (woken.revents & POLLIN) != 0 &&
      read(ring->wake, wake_ups, sizeof(wake_ups)) < 0 && errno != EAGAIN && errno != EINTR) {
    return bad_data(client, "a ring whose wake-ups can't be read");
  }
  const int outcome = newest_head(client);
  if (outcome != FACET_OK && !(outcome == AGAIN && client->fd >= 0 && client->ring_head_waits)) {
    return outcome;
  }
  const uint64_t wanted = wire_frame_subject(client->frame_message.bytes, client->frame_message.size);
  client->ring_head_waits = wanted != 0 && (!client->has_subject || client->subject.shown.id != wanted);
  if (client->ring_head_waits) {
    return AGAIN;
  }
  const uint8_t* slot = ring_slot(ring, ring->publication);
  for (int k = 0; k < FACET_RING_ARRAY_COUNT; ++k) {
    const struct facet_ring_array* array = &ring->slot.arrays[k];
    arrays[k].data = array->offset != 0 ? slot + array->offset : NULL;
    arrays[k].count = array->count;
  }
  const char* wrong = wire_frame(client->frame_message.bytes, client->frame_message.size,
                                 wanted != 0 ? &client->subject : NULL, arrays, &client->frame);
  if (wrong != NULL) {
    return bad_data(client, wrong);
  }
  if (ring->number > 0 && ring->slot.number > ring->number) {
    client->statistics.dropped += ring->slot.number - ring->number - 1;
  }
  ring->number = ring->slot.number;
  return FACET_OK;
}

/* messages */

static int accept_hello(facet_client* client) {
  uint32_t version = 0;
  const char* wrong = wire_hello(client->incoming.bytes, client->incoming.size, &version);
  if (wrong != NULL) {
    return bad_data(client, wrong);
  }
  if (version != WIRE_VERSION) {
    say(client, "'%s' speaks protocol version %u, this library version %d: use programs of one release",
        client->address.sun_path, version, WIRE_VERSION);
    return lost(client, FACET_BAD_DATA);
  }
  return client->subscribed ? AGAIN : subscribe(client);
}

static int accept_frame(facet_client* client) {
  const uint64_t wanted = wire_frame_subject(client->incoming.bytes, client->incoming.size);
  keep(client, &client->frame_message);
  const struct wire_subject* subject =
      wanted != 0 && client->has_subject && client->subject.shown.id == wanted ? &client->subject : NULL;
  const char* wrong =
      wire_frame(client->frame_message.bytes, client->frame_message.size, subject, NULL, &client->frame);
  return wrong == NULL ? FACET_OK : bad_data(client, wrong);
}

/* FACET_OK: it was a frame. AGAIN: it was something else. */
static int accept_message(facet_client* client) {
  const uint8_t* bytes = client->incoming.bytes;
  const size_t size = client->incoming.size;
  const char* wrong = NULL;
  const char* reason = "";
  uint64_t total = 0;
  uint32_t version = 0;
  const int kind = size > 0 ? wire_kind(bytes, size) : WIRE_BROKEN;
  switch (kind) {
    case WIRE_BROKEN:
      wrong = "it is no message";
      break;
    case WIRE_HELLO:
      return accept_hello(client);
    case WIRE_DROPPED:
      wrong = wire_dropped(bytes, size, &total);
      client->statistics.dropped += total > client->dropped_told ? total - client->dropped_told : 0;
      client->dropped_told = total;
      break;
    case WIRE_GOODBYE:
      wrong = wire_goodbye(bytes, size, &reason);
      if (wrong == NULL) {
        say(client, "%s", reason);
        return lost(client, FACET_CLOSED);
      }
      break;
    case WIRE_SUBJECT:
      keep(client, &client->subject_message);
      client->has_albedo = 0;
      wrong = wire_subject(client->subject_message.bytes, size, &client->subject);
      client->has_subject = wrong == NULL;
      break;
    case WIRE_ALBEDO:
      keep(client, &client->albedo_message);
      wrong = wire_albedo(client->albedo_message.bytes, size, &client->albedo);
      client->has_albedo = wrong == NULL;
      break;
    case WIRE_FRAME:
      return accept_frame(client);
    case WIRE_RING:
      wrong = wire_ring(bytes, size, &version);
      if (wrong == NULL) {
        return open_ring(client, version);
      }
      break;
    default: /* of a later release */
      break;
  }
  return wrong == NULL ? AGAIN : bad_data(client, wrong);
}

/* the interface */

facet_client* facet_client_new(const char* socket_path, int profile, unsigned flags, const char* name) {
  struct sockaddr_un address;
  if (profile < FACET_SIGNALS || profile > FACET_VERTICES || !address_of(socket_path, &address)) {
    errno = EINVAL;
    return NULL;
  }
  facet_client* client = calloc(1, sizeof(*client));
  if (client == NULL) {
    return NULL;
  }
  client->address = address;
  client->profile = profile;
  client->flags = flags;
  client->fd = -1;
  client->ring.wake = -1;
  client->pause_ms = FIRST_PAUSE_MS;
  snprintf(client->name, sizeof(client->name), "%s", name != NULL ? name : "libfacet-client");
  return client;
}

void facet_client_free(facet_client* client) {
  if (client == NULL) {
    return;
  }
  hang_up(client);
  free(client->incoming.bytes);
  free(client->frame_message.bytes);
  free(client->subject_message.bytes);
  free(client->albedo_message.bytes);
  rebuild_free(&client->mesh_memory);
  free(client);
}

/* Whatever can be done at once. FACET_OK: a frame is there. AGAIN: wait for something, or it is late. */
static int advance(facet_client* client) {
  if (client->fd < 0) {
    if (now_ms() < client->retry_ms) {
      return AGAIN;
    }
    const int outcome = connect_now(client);
    if (outcome != FACET_OK) {
      return outcome;
    }
    client->message[0] = '\0';
  }
  for (;;) {
    int outcome = client->ring.memory != NULL ? next_of_ring(client) : AGAIN;
    if (outcome != AGAIN || client->fd < 0) {
      return outcome;
    }
    outcome = receive_message(client);
    if (outcome != FACET_OK) {
      return outcome;
    }
    outcome = accept_message(client);
    if (outcome != AGAIN || client->fd < 0 || late(client)) {
      return outcome;
    }
  }
}

/* Until something comes, the time to connect again is there, or the deadline. */
static void wait_for_more(const facet_client* client, int64_t left_ms) {
  struct pollfd entries[2] = {{client->fd, POLLIN, 0}, {client->ring.wake, POLLIN, 0}};
  if (client->fd < 0) {
    const int64_t pause_ms = client->retry_ms - now_ms();
    left_ms = left_ms < 0 || pause_ms < left_ms ? pause_ms : left_ms;
    left_ms = left_ms < 0 ? 0 : left_ms;
    poll(NULL, 0, (int)left_ms);
    return;
  }
  poll(entries, client->ring.memory != NULL ? 2 : 1, left_ms < 0 ? -1 : (int)left_ms);
}

int facet_client_next(facet_client* client, int timeout_ms) {
  const int64_t deadline_ms = now_ms() + timeout_ms;
  client->late_ms = timeout_ms < 0 ? INT64_MAX : deadline_ms + GRACE_MS;
  client->has_frame = 0;
  if ((client->flags & FACET_RECONNECT) == 0) {
    client->retry_ms = 0;
  }
  for (;;) {
    const int outcome = advance(client);
    if (outcome == FACET_OK) {
      client->has_frame = 1;
      client->heard_ms = now_ms();
      client->pause_ms = FIRST_PAUSE_MS;
      ++client->statistics.received;
    }
    if (outcome != AGAIN) {
      return outcome;
    }
    const int64_t left_ms = timeout_ms < 0 ? -1 : deadline_ms - now_ms();
    if (timeout_ms >= 0 && left_ms <= 0) {
      if (client->fd >= 0) {
        say(client, "connected to '%s', but no frame for %.1f s", client->address.sun_path,
            (double)(now_ms() - client->heard_ms) * 1e-3);
      }
      return FACET_TIMEOUT;
    }
    wait_for_more(client, left_ms);
  }
}

const char* facet_client_message(const facet_client* client) {
  return client->message;
}

const facet_frame* facet_client_frame(const facet_client* client) {
  return client->has_frame ? &client->frame : NULL;
}

/* values: [expression_count] of the frame, where it has a face. */
static float value_of(const facet_client* client, const float* values, const char* name) {
  if (client->has_frame && client->frame.subject_id != 0) {
    for (size_t k = 0; k < client->frame.expression_count; ++k) {
      if (strcmp(client->subject.names[k], name) == 0) {
        return values[k];
      }
    }
  }
  return NAN;
}

float facet_client_expression(const facet_client* client, const char* name) {
  return value_of(client, client->frame.expression, name);
}

float facet_client_avatar_value(const facet_client* client, const char* name) {
  return value_of(client, client->frame.avatar_values, name);
}

const facet_subject* facet_client_subject(const facet_client* client) {
  return client->has_subject ? &client->subject.shown : NULL;
}

const facet_albedo* facet_client_albedo(const facet_client* client) {
  return client->has_albedo ? &client->albedo : NULL;
}

int facet_client_mesh(facet_client* client, const facet_mesh** mesh) {
  if (!client->has_frame || client->frame.subject_id == 0) {
    return FACET_NO_MESH;
  }
  const int outcome = rebuild_mesh(&client->frame, &client->subject, &client->mesh_memory, &client->mesh);
  if (outcome != FACET_OK) {
    return outcome;
  }
  if (!facet_client_intact(client)) {
    ++client->statistics.overwritten;
    return FACET_OVERWRITTEN;
  }
  *mesh = &client->mesh;
  return FACET_OK;
}

int facet_client_intact(const facet_client* client) {
  return !client->has_frame || !client->frame.in_ring || ring_intact(&client->ring);
}

const facet_statistics* facet_client_statistics(const facet_client* client) {
  return &client->statistics;
}

const char* facet_client_version(void) {
  return FACET_VERSION;
}
