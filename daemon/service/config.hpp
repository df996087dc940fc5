#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "avatar/bridge.hpp"
#include "files/toml_section.hpp"
#include "pipeline/booth_config.hpp"
#include "pipeline/devices_config.hpp"
#include "pipeline/shading_config.hpp"
#include "service/log.hpp"
#include "sound/capture.hpp"
#include "stream/server.hpp"

namespace facet::service {

struct ControlConfig {
  std::filesystem::path socket = "/run/facet/control.sock";
  stream::SocketAccess access;
  std::size_t max_clients = 64;  ///< places, as many again for those of the page
};

struct TakesConfig {
  std::filesystem::path folder = "/var/lib/facet/takes";
  std::uint64_t disk_reserve_bytes = 256ULL << 20;
  int compression_level = 1;    ///< of zstd, for meshes
  std::string record_at_start;  ///< name of a take that begins with the first frame; empty: none
  bool pictures = true;         ///< of one live camera, as JPEG
};

struct MetricsConfig {
  std::string listen = "127.0.0.1:9464";  ///< "ADDRESS:PORT"; empty: off
  std::size_t max_connections = 16;
};

/// The page and its WebSockets (WebServer).
struct WebConfig {
  std::string listen;                                             ///< "ADDRESS:PORT"; empty: off
  bool is_public = false;                                         ///< an address that others reach is meant
  bool open_look = false;                                         ///< there, too, looking needs no token
  std::filesystem::path page;                                     ///< folder of the page's files
  std::filesystem::path token_file = "/var/lib/facet/web-token";  ///< empty: nobody commands over the web
  std::vector<std::string> hosts;    ///< further names under which the page may be asked for
  std::vector<std::string> origins;  ///< further pages, "http://NAME[:PORT]", that may use the WebSockets
  int max_readers = 16;              ///< readers of the stream over WebSockets
  std::size_t max_connections = 64;  ///< requests at a time, those of WebSockets not counted
  std::size_t max_downloads = 16;    ///< of them
};

/// Takes begun and ended by OSC (OscRemote).
struct OscConfig {
  std::string listen;      ///< "ADDRESS:PORT" of UDP; empty: off
  bool is_public = false;  ///< an address that others reach is meant
};

enum class Mode {
  Monocular,  ///< refined meshes of one source, or of several calibrated cameras
  Frames,     ///< the pictures of several cameras, no meshes
  Booth,      ///< the same, and meshes of them
};
inline constexpr std::array kModes = {"monocular", "frames", "booth"};

/// What a take of a booth holds.
enum class BoothRecord {
  Pictures,  ///< every frame set, for `facet process`
  Meshes,    ///< the meshes that were made live
};

/// All that a configuration file says, and limits that fit_descriptors lowers; defaults are those of
/// config/facet.toml. Running state is elsewhere (Service).
struct Config {
  Mode mode = Mode::Monocular;
  pipeline::ShadingConfig pipeline;  ///< source.path or source.live.device empty: not given
  pipeline::DevicesConfig devices;   ///< modes Frames and Booth; Monocular where it has cameras
  stereo::DepthRange booth_depths;   ///< BoothConfig::depths
  std::filesystem::path rig_file;    ///< modes Booth, and Monocular with cameras
  bool booth_every_slot = false;     ///< BoothConfig::every_slot
  bool booth_lights = true;          ///< BoothConfig::lights
  bool booth_shading = false;        ///< BoothConfig::shading
  BoothRecord booth_record = BoothRecord::Pictures;
  bool exit_at_end = false;  ///< or where the source fails
  bool wait_for_reader = false;
  stream::StreamServerConfig stream;
  ControlConfig control;
  TakesConfig takes;
  sound::SoundConfig sound;
  OscConfig osc;
  avatar::BridgeConfig bridges;
  MetricsConfig metrics;
  WebConfig web;
  LogLevel log_level = LogLevel::Info;
  std::vector<std::string>
      warnings;  ///< of the file: keys that stand where they will not be read much longer
};

/// The configuration of an empty file.
Config default_config();

/// Reads a TOML configuration file. Relative paths in it are relative to its folder. Throws
/// Error(UnreadableInput) where the file can't be read and Error(Usage) for what is wrong in it, naming file,
/// line, key and allowed values; an unknown key is an error that suggests the nearest known one.
Config load_config(const std::filesystem::path& file);

/// The same for text; `file` is for messages and for relative paths.
Config parse_config(std::string_view text, const std::filesystem::path& file);

/// Whether meshes are made of several calibrated cameras: mode Monocular with [[camera]]s.
bool has_live_cameras(const Config& config);

/// What mode Booth asks of the meshes; the slots are those of the trigger's program, where it has one.
pipeline::BoothConfig booth_config(const Config& config);

/// Every key that a configuration file may have, what a text makes of it and its bounds.
std::vector<files::TomlKey> config_values(std::string_view text, const std::filesystem::path& file);

/// A configuration file larger than this is refused, bytes.
inline constexpr std::size_t kMaxConfigBytes = 1U << 20;

}  // namespace facet::service
