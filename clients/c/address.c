#define _GNU_SOURCE
#include "address.h"

#include <errno.h>
#include <grp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/stat.h>

#include "facet-client.h"

enum { GROUP_ENTRY_BYTES = 16384 };

int address_of(const char* path, struct sockaddr_un* out) {
  if (path == NULL || path[0] == '\0') {
    path = getenv("FACET_SOCKET");
  }
  if (path == NULL || path[0] == '\0') {
    path = FACET_DEFAULT_SOCKET;
  }
  const size_t length = strlen(path);
  if (length >= sizeof(out->sun_path)) {
    return 0;
  }
  memset(out, 0, sizeof(*out));
  out->sun_family = AF_UNIX;
  memcpy(out->sun_path, path, length + 1);
  return 1;
}

/* The group that may connect: the socket's, or its folder's where that hides it. "": not to be found out. */
static void group_of(const struct sockaddr_un* address, char* out, size_t size) {
  char folder[sizeof(address->sun_path)];
  char entry_text[GROUP_ENTRY_BYTES];
  struct stat status;
  struct group entry;
  struct group* found = NULL;
  out[0] = '\0';
  if (stat(address->sun_path, &status) != 0) {
    snprintf(folder, sizeof(folder), "%s", address->sun_path);
    char* slash = strrchr(folder, '/');
    if (slash == NULL) {
      return;
    }
    *slash = '\0';
    if (stat(folder, &status) != 0) {
      return;
    }
  }
  if (getgrgid_r(status.st_gid, &entry, entry_text, sizeof(entry_text), &found) == 0 && found != NULL) {
    snprintf(out, size, "%s", entry.gr_name);
  } else {
    snprintf(out, size, "%lu", (unsigned long)status.st_gid);
  }
}

void address_trouble(const struct sockaddr_un* address, int error, char* out, size_t size) {
  char group[64];
  const char* path = address->sun_path;
  switch (error) {
    case ENOENT:
    case ECONNREFUSED:
      snprintf(out, size, "nobody answers at the socket '%s': is facetd running with this path?", path);
      return;
    case EACCES:
      group_of(address, group, sizeof(group));
      snprintf(out, size, "no permission for the socket '%s': this user must be a member of the group '%s'",
               path, group[0] != '\0' ? group : "its owner");
      return;
    default:
      snprintf(out, size, "cannot connect to the socket '%s': %s", path, strerror(error));
  }
}
