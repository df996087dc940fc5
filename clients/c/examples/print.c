/* Prints the frames of a running facetd: cc print.c $(pkg-config --cflags --libs facet-client)
 * Usage: print [SOCKET [FRAMES]] */
#include <facet-client.h>
#include <stdio.h>
#include <stdlib.h>

int main(int argc, char** argv) {
  const char* socket_path = argc > 1 ? argv[1] : NULL;
  const long frames = argc > 2 ? strtol(argv[2], NULL, 10) : 0;
  facet_client* client =
      facet_client_new(socket_path, FACET_SIGNALS, FACET_RECONNECT | FACET_WANT_RING, "print");
  if (client == NULL) {
    perror("facet_client_new");
    return 1;
  }
  for (long printed = 0; frames == 0 || printed < frames;) {
    const int outcome = facet_client_next(client, 5000);
    if (outcome == FACET_TIMEOUT) {
      fprintf(stderr, "%s\n", facet_client_message(client));
      continue;
    }
    if (outcome != FACET_OK) {
      fprintf(stderr, "%s\n", facet_client_message(client));
      facet_client_free(client);
      return 1;
    }
    const facet_frame* frame = facet_client_frame(client);
    const facet_subject* subject = facet_client_subject(client);
    printf("frame %llu", (unsigned long long)frame->sequence);
    for (size_t k = 0; k < frame->expression_count; ++k) {
      printf(" %s %.3f", subject->expression_names[k], (double)frame->expression[k]);
    }
    printf("\n");
    ++printed;
  }
  facet_client_free(client);
  return 0;
}
