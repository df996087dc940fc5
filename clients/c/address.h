#ifndef FACET_CLIENT_ADDRESS_H
#define FACET_CLIENT_ADDRESS_H

#include <stddef.h>
#include <sys/un.h>

/* Where the server listens, and why it can't be reached. Any thread. */

/* path     NULL or "": what FACET_SOCKET of the environment names, else FACET_DEFAULT_SOCKET
 * returns  0 where the path does not fit into an address */
int address_of(const char* path, struct sockaddr_un* out);

/* A sentence for people: whether nobody listens there, this user may not (and which group may), or what else.
 *
 * error  errno of connect()
 * out    [size] ends with a 0 */
void address_trouble(const struct sockaddr_un* address, int error, char* out, size_t size);

#endif
