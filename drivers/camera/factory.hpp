#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "camera/turned_camera.hpp"
#include "facet/camera.hpp"
#include "facet/setting.hpp"

namespace facet::camera {

/// A control of a device by its name in the driver ("Trigger Mode" or trigger_mode): a switch, a number, or
/// an entry of a menu by its text.
struct ControlSetting {
  std::string name;
  std::variant<bool, std::int64_t, std::string> value;
};

/// How a live camera is set. Without a value a control is regulated by the device itself, where it can.
struct LiveConfig {
  std::filesystem::path
      device{};                 ///< v4l2: such as /dev/v4l/by-path/..., which names a socket, or /dev/video0
  std::string format = "auto";  ///< one of kV4l2Formats
  int width_px = 1280;
  int height_px = 720;
  double rate_hz = 30;
  std::optional<int> exposure_us{};
  std::optional<int> gain{};                    ///< v4l2: in units of the device
  std::optional<int> white_balance_k{};         ///< colour temperature
  std::vector<ControlSetting> controls{};       ///< v4l2: set in this order, after those above
  unsigned buffers = 4;                         ///< that the driver fills in turn
  std::chrono::milliseconds stall_after{2000};  ///< without a frame: the device is started anew
};

/// "auto": the first of those after it that has size and rate.
inline constexpr std::array kV4l2Formats = {"auto", "YUYV", "NV12", "MJPEG", "GREY", "Y16", "Y10"};

/// What a camera of libcamera is set to beyond LiveConfig.
struct LibcameraConfig {
  std::string id{};                  ///< of libcamera; empty: the only camera there is
  std::optional<double> gain{};      ///< analogue, times; instead of LiveConfig::gain
  std::optional<double> red_gain{};  ///< of the white balance; both or none
  std::optional<double> blue_gain{};
};

/// The same for libcamera.
inline constexpr std::array kLibcameraFormats = {"auto", "YUYV", "NV12", "RGB", "MJPEG", "GREY", "Y10"};

/// Which source, and how it behaves. Kinds: "file" (any video or picture that FFmpeg reads), "v4l2" (a camera
/// of the Linux kernel), "libcamera" (one that libcamera drives, in a process of its own), "simulated" (one
/// without a device).
struct CameraConfig {
  std::string kind = "file";
  std::filesystem::path path{};  ///< file: the video
  bool paced = false;  ///< file: deliver at the recorded rate and skip what the reader is too slow for, like
                       ///< a live camera
  bool loop = false;   ///< file: start over at the end; sequence and times go on
  LiveConfig live{};   ///< v4l2, libcamera; of simulated ones size and rate
  LibcameraConfig libcamera{};
  PictureTurn turn{};  ///< v4l2, libcamera, simulated
};

using CameraSetting = Setting<CameraConfig>;

/// Settings that several kinds have.
inline constexpr CameraSetting kWidthSetting{"width_px", &at<&CameraConfig::live, &LiveConfig::width_px>, 16,
                                             16384};
inline constexpr CameraSetting kHeightSetting{"height_px", &at<&CameraConfig::live, &LiveConfig::height_px>,
                                              16, 16384};
inline constexpr CameraSetting kRateSetting{"rate_hz", &at<&CameraConfig::live, &LiveConfig::rate_hz>, 1,
                                            1000};
inline constexpr CameraSetting kExposureSetting{
    "exposure_us", &at<&CameraConfig::live, &LiveConfig::exposure_us>, 1, 10'000'000};
inline constexpr CameraSetting kWhiteBalanceSetting{
    "white_balance_k", &at<&CameraConfig::live, &LiveConfig::white_balance_k>, 1000, 20'000};
inline constexpr CameraSetting kBuffersSetting{"buffers", &at<&CameraConfig::live, &LiveConfig::buffers>, 2,
                                               32};
inline constexpr CameraSetting kStallAfterSetting{
    "stall_after_ms", &at<&CameraConfig::live, &LiveConfig::stall_after>, 100, 3'600'000};

inline constexpr CameraSetting kTurnSetting{"turn", &at<&CameraConfig::turn, &PictureTurn::clockwise_deg>, 0,
                                            270};
inline constexpr CameraSetting kMirrorSetting{"mirror", &at<&CameraConfig::turn, &PictureTurn::mirror>};

/// A camera that is there, for people.
struct FoundCamera {
  std::string text;      ///< what it is and what it offers, or why it can't be used
  std::string controls;  ///< what can be set by name; empty: nothing
};

/// A kind of source. Its driver's file has it, camera_kinds() lists it.
struct CameraKind {
  const char* name;
  std::span<const CameraSetting> settings;
  bool has_controls = false;     ///< takes LiveConfig::controls, too
  const char* needs = nullptr;   ///< the setting without which it is no source; null: it finds one by itself
  const char* advice = nullptr;  ///< what to do where that is missing
  /// Two settings that are given together or not at all.
  std::optional<std::array<const char*, 2>> pair{};
  /// As open_camera, before pictures are turned.
  std::unique_ptr<Camera> (*open)(const CameraConfig& config) = nullptr;
  /// Those that are there; throws Error where it can't tell. Null: nobody looks for them.
  std::vector<FoundCamera> (*list)() = nullptr;

  /// Null: the kind has none of that key.
  const CameraSetting* find(std::string_view key) const;
  /// Whether the setting says something: it is no empty text, and not "auto".
  bool says(std::string_view key, CameraConfig config) const;
};

/// In the order in which messages name them.
std::span<const CameraKind* const> camera_kinds();

/// Throws Error(Usage) that names the kinds there are.
const CameraKind& camera_kind(std::string_view name);

/// Whether what the source needs to be found is configured: a file, a device.
bool names_source(const CameraConfig& config);

/// Opens a source; throws Error(Usage) for an unknown kind or a device that can't do what is asked, naming
/// what it can, and Error(UnreadableInput) naming the file and what is wrong with it. A device that is absent
/// or fails is no error: see CameraStatus.
std::unique_ptr<Camera> open_camera(const CameraConfig& config);

}  // namespace facet::camera
