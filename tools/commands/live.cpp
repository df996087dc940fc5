// `facet live`: a camera or a video on a page of this machine, without a configuration of one's own.

#include <fcntl.h>
#include <fmt/format.h>
#include <netinet/in.h>
#include <sys/random.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <memory>
#include <string>
#include <system_error>
#include <vector>

#include "camera/v4l2_camera.hpp"
#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "options.hpp"
#include "picture_size.hpp"
#include "programs.hpp"
#include "tell.hpp"

namespace facet::tools {
namespace {

struct LiveOptions {
  std::string source;
  std::string size;
  double rate_hz = 0;
  std::string takes;
  std::string gpu = "auto";
  int port = 8420;
  bool print = false;
};

/// A string of TOML.
std::string quoted(const std::string& text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') {
      out += '\\';
    }
    if (static_cast<unsigned char>(c) < 0x20) {
      throw Error(ErrorKind::Usage, fmt::format("'{}' has a control character in its name", text));
    }
    out += c;
  }
  return out + "\"";
}

/// The first camera of the kernel's that delivers pictures.
std::string first_camera() {
  const std::vector<camera::V4l2Description> found = camera::list_v4l2_devices();
  if (found.empty()) {
    throw Error(ErrorKind::Unavailable,
                "no camera is plugged in (/dev/video*): plug one in, or name a video: facet live face.mp4");
  }
  for (std::size_t k = 1; k < found.size(); ++k) {
    tell(stderr, "note: there is also {} ({}): facet live {}\n", found[k].path, found[k].card, found[k].path);
  }
  tell("camera        {} ({})\n", found.front().path, found.front().card);
  return found.front().path;
}

bool is_device(const std::string& source) {
  std::error_code ignored;
  return source.starts_with("/dev/") || std::filesystem::is_character_file(source, ignored);
}

std::string source_section(const LiveOptions& options) {
  const std::string source = options.source.empty() ? first_camera() : options.source;
  if (!is_device(source)) {
    std::error_code ignored;
    if (!std::filesystem::is_regular_file(source, ignored)) {
      throw Error(ErrorKind::UnreadableInput,
                  fmt::format("'{}' is neither a camera (/dev/video0) nor a video", source));
    }
    if (!options.size.empty() || options.rate_hz > 0) {
      throw Error(ErrorKind::Usage, "--size and --rate are a camera's: a video has its own");
    }
    return fmt::format("[source]\nkind = \"file\"\npath = {}\npaced = true\nloop = true\n",
                       quoted(std::filesystem::absolute(source).lexically_normal().string()));
  }
  std::string section = fmt::format("[source]\nkind = \"v4l2\"\ndevice = {}\n", quoted(source));
  if (!options.size.empty()) {
    const PictureSize size = parse_picture_size("--size", options.size);
    section += fmt::format("width_px = {}\nheight_px = {}\n", size.width_px, size.height_px);
  }
  if (options.rate_hz > 0) {
    section += fmt::format("rate_hz = {}\n", options.rate_hz);
  }
  return section;
}

/// For sockets and the page's token: it goes with the session.
std::filesystem::path session_folder() {
  const char* runtime = std::getenv("XDG_RUNTIME_DIR");
  const std::filesystem::path parent = runtime != nullptr && *runtime != '\0'
                                           ? std::filesystem::path(runtime)
                                           : std::filesystem::temp_directory_path();
  return parent / fmt::format("facet-live-{}", ::geteuid());
}

/// Makes the folder, or takes one that is this user's alone: in a folder that all may write to, somebody else
/// may have been first.
void make_own(const std::filesystem::path& folder) {
  if (::mkdir(folder.c_str(), 0700) != 0 && errno != EEXIST) {
    throw Error(ErrorKind::Storage,
                fmt::format("cannot make '{}': {}", folder.string(), std::strerror(errno)));
  }
  struct stat is {};
  if (::lstat(folder.c_str(), &is) != 0 || !S_ISDIR(is.st_mode) || is.st_uid != ::geteuid() ||
      (is.st_mode & 077) != 0) {
    throw Error(ErrorKind::Storage,
                fmt::format("'{}' is no folder of yours alone: remove it", folder.string()));
  }
}

/// Whether something answers there already: its page would be taken for ours.
bool is_taken(int port) {
  const int probe = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  address.sin_port = htons(static_cast<std::uint16_t>(port));
  const bool answered =
      probe >= 0 && ::connect(probe, reinterpret_cast<const sockaddr*>(&address), sizeof(address)) == 0;
  if (probe >= 0) {
    ::close(probe);
  }
  return answered;
}

/// Everything that the daemon would keep lies in the session's folder, but for the takes.
std::string config_of(const LiveOptions& options, const std::filesystem::path& folder,
                      const std::filesystem::path& takes, const std::filesystem::path& token_file) {
  const auto in = [&](const char* name) { return quoted((folder / name).string()); };
  return fmt::format(
      "# Written by `facet live`; a copy of it is a beginning for a configuration of your own.\n"
      "{}\n[gpu]\ndevice = {}\n\n[stream]\nsocket = {}\n\n[control]\nsocket = {}\n\n[takes]\nfolder = {}\n\n"
      "[persons]\nfolder = \"\"\n\n[bridges]\nneutral = {}\n\n[metrics]\nlisten = \"\"\n\n"
      "[web]\nlisten = \"127.0.0.1:{}\"\ntoken_file = {}\n",
      source_section(options), quoted(options.gpu), in("stream.sock"), in("control.sock"),
      quoted(takes.string()), in("neutral.json"), options.port, quoted(token_file.string()));
}

void write(const std::filesystem::path& file, const std::string& text) {
  files::OutputFile out(file, 0600);
  out.write(text);
  out.commit();
}

/// Another for each run: who has the page's address may command.
std::string new_token() {
  std::array<unsigned char, 16> bytes{};
  if (::getrandom(bytes.data(), bytes.size(), 0) != static_cast<ssize_t>(bytes.size())) {
    throw Error(ErrorKind::Internal, fmt::format("no random numbers: {}", std::strerror(errno)));
  }
  std::string token;
  for (const unsigned char byte : bytes) {
    token += fmt::format("{:02x}", byte);
  }
  return token;
}

/// Becomes facetd.
void run_live(const LiveOptions& options) {
  const std::string facetd = program("facetd").string();
  const std::filesystem::path folder = session_folder();
  const std::filesystem::path takes =
      std::filesystem::absolute(options.takes.empty() ? "facet-takes" : options.takes).lexically_normal();
  const std::filesystem::path token_file = folder / "web-token";
  const std::filesystem::path config = folder / "facet.toml";
  const std::string text = config_of(options, folder, takes, token_file);
  if (options.print) {
    tell("{}", text);
    return;
  }
  if (is_taken(options.port)) {
    throw Error(ErrorKind::Usage,
                fmt::format("something answers on port {} already, maybe another facetd: end it, or choose "
                            "another with --port",
                            options.port));
  }
  make_own(folder);
  files::make_folder(takes);
  const std::string token = new_token();
  write(token_file, token + "\n");
  write(config, text);
  tell("page          http://127.0.0.1:{}/#token={}\n", options.port, token);
  tell("takes         {}\n", takes.string());
  tell("programs      FACET_SOCKET={}\n", (folder / "stream.sock").string());
  tell("commands      facet status --config {}\n", config.string());
  tell("end           Ctrl-C\n");
  std::fflush(stdout);
  ::execl(facetd.c_str(), "facetd", "--config", config.c_str(), nullptr);
  throw Error(ErrorKind::Internal, fmt::format("cannot start {}: {}", facetd, std::strerror(errno)));
}

}  // namespace

void add_live_command(Command app) {
  auto options = std::make_shared<LiveOptions>();
  const Command command = app.subcommand(
      "live", "Follow a camera's or a video's face, with the page on this machine, without a configuration");
  command.option("source", options->source,
                 "The camera (/dev/video0) or a video, which is played in a loop; default: the first camera");
  command.option("--size", options->size, "Of a camera: WIDTHxHEIGHT in pixels (default: 1280x720)");
  command.option("--rate", options->rate_hz, "Of a camera: pictures a second (default: 30)")
      .range(1.0, 1000.0);
  command.option("--takes", options->takes, "Folder for what is recorded (default: facet-takes, here)");
  command.option("--device", options->gpu,
                 "Vulkan device: auto, part of its name, or none (coarse meshes only)");
  command.option("--port", options->port, "Of the page").shows_default().range(1, 65535);
  command.flag("--print", options->print, "Print the configuration, and do nothing");
  command.callback([options] { run_live(*options); });
}

}  // namespace facet::tools
