// A stream server with one frame for programs that are tested from outside: says "ready", ends with its
// input. Usage: patch_server SOCKET

#include <cstdio>

#include "stream/server.hpp"
#include "support/mesh_frames.hpp"

int main(int argc, char** argv) {
  using namespace facet;
  if (argc != 2) {
    return 2;
  }
  stream::StreamServerConfig config;
  config.socket = argv[1];
  stream::StreamServer server(config);
  server.start();
  const auto subject = test::patch_subject();
  server.publish(
      std::make_shared<mesh::MeshFrame>(test::patch_frame(7, subject, test::patch_albedo(*subject))));
  std::puts("ready");
  std::fflush(stdout);
  while (std::getchar() != EOF) {
  }
  server.stop();
  return 0;
}
