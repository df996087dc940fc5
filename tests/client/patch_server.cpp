// A stream server with one frame, over its socket and for browsers, for programs that are tested from
// outside: says the port, ends with its input. Each line of it is a number of control vertices a side: the
// next frame is of such a mesh, under the id that was there. Usage: patch_server FOLDER, in which its sockets
// and files come to lie, stream.sock and others

#include <cstdio>

#include "service/web_server.hpp"
#include "stream/server.hpp"
#include "support/mesh_frames.hpp"

int main(int argc, char** argv) {
  using namespace facet;
  if (argc != 2) {
    return 2;
  }
  const std::filesystem::path folder = argv[1];
  stream::StreamServerConfig config;
  config.socket = folder / "stream.sock";
  config.max_web_readers = 4;
  stream::StreamServer server(config);
  server.start();
  service::ControlConfig control_config;
  control_config.socket = folder / "control.sock";
  service::ControlServer control(control_config, {});
  service::WebConfig web_config;
  web_config.listen = "127.0.0.1:0";
  web_config.page = folder;
  web_config.token_file = folder / "token";
  const service::WebServer web(web_config, folder, {}, server, control);
  auto subject = test::patch_subject();
  const auto publish = [&](std::uint64_t sequence) {
    mesh::MeshFrame frame = test::patch_frame(sequence, subject, test::patch_albedo(*subject));
    frame.expression_confidence.assign(frame.expression.size(), 0.2F);
    frame.avatar_values.assign(frame.expression.size(), 0.5F);
    frame.origin = mesh::Origin::Take;
    server.publish(std::make_shared<mesh::MeshFrame>(std::move(frame)));
  };
  std::uint64_t sequence = 7;
  publish(sequence);
  std::printf("%d\n", web.port());
  std::fflush(stdout);
  for (int side = 0; std::scanf("%d", &side) == 1;) {
    auto known = std::make_shared<mesh::Subject>(*test::patch_subject(subject->id, side));
    known->person = "Ada";
    known->neutral_mm = mesh::Vertices::Zero(3, known->hierarchy->control_vertex_count);
    subject = known;
    publish(++sequence);
  }
  server.stop();
  return 0;
}
