#pragma once

#include "camera/factory.hpp"
#include "facet/setting.hpp"
#include "pipeline/devices_config.hpp"
#include "pipeline/shading_config.hpp"
#include "service/config.hpp"
#include "stream/protocol.hpp"

// Keys of the configuration whose values are plain: for each section a row a key, with the member that holds
// it and its bounds. Values that are written in a way of their own are read in config.cpp.

namespace facet::service {

inline constexpr std::int64_t kMicrosecond_ns = 1000;
inline constexpr std::int64_t kMebibyte = 1 << 20;

inline constexpr Setting<Config> kSourceSettings[] = {
    {"exit_at_end", &at<&Config::exit_at_end>},
    {"wait_for_reader", &at<&Config::wait_for_reader>},
};

/// A focal length or picture beyond these bounds is a slip of the pen, not a camera.
inline constexpr Setting<CameraIntrinsics> kIntrinsicsSettings[] = {
    {"fx", &at<&CameraIntrinsics::fx>, 1, 1e6},
    {"fy", &at<&CameraIntrinsics::fy>, 1, 1e6},
    {"cx", &at<&CameraIntrinsics::cx>, -1e6, 1e6},
    {"cy", &at<&CameraIntrinsics::cy>, -1e6, 1e6},
    {"width_px", &at<&CameraIntrinsics::width_px>, 16, 65536},
    {"height_px", &at<&CameraIntrinsics::height_px>, 16, 65536},
};

inline constexpr Setting<pipeline::DeviceCamera> kCameraSettings[] = {
    {"name", &at<&pipeline::DeviceCamera::name>},
    {"latency_us", &at<&pipeline::DeviceCamera::latency_ns>, -1e6, 1e6, kMicrosecond_ns},
};

inline constexpr Setting<pipeline::DevicesConfig> kTriggerSettings[] = {
    {"slots_per_second", &at<&pipeline::DevicesConfig::program, &TriggerProgram::slots_per_second>, 1, 1000},
    {"settle_us", &at<&pipeline::DevicesConfig::program, &TriggerProgram::settle_ns>, 0, 1e6,
     kMicrosecond_ns},
    {"exposure_us", &at<&pipeline::DevicesConfig::program, &TriggerProgram::exposure_ns>, 1, 1e6,
     kMicrosecond_ns},
    {"real_time", &at<&pipeline::DevicesConfig::gpio, &trigger::GpioTriggerConfig::thread,
                      &trigger::ThreadOptions::real_time>},
    {"edge_log", &at<&pipeline::DevicesConfig::edge_log>},
};

inline constexpr Setting<TriggerLine> kTriggerLineSettings[] = {
    {"name", &at<&TriggerLine::name>},
    {"active_low", &at<&TriggerLine::active_low>},
    {"rest_active", &at<&TriggerLine::safe_active>},
    {"pulse_us", &at<&TriggerLine::pulse_ns>, 0, 1e6, kMicrosecond_ns},
};

inline constexpr Setting<trigger::GpioOutput> kOutputSettings[] = {
    {"chip", &at<&trigger::GpioOutput::chip>},
    {"line", &at<&trigger::GpioOutput::line>},
};

inline constexpr Setting<trigger::GpioReadBack> kReadBackSettings[] = {
    {"read_back_chip", &at<&trigger::GpioReadBack::chip>},
    {"read_back_line", &at<&trigger::GpioReadBack::line>},
    {"read_back_active_low", &at<&trigger::GpioReadBack::active_low>},
};

inline constexpr Setting<pipeline::DevicesConfig> kSimulationSettings[] = {
    {"footage", &at<&pipeline::DevicesConfig::footage>},
};

inline constexpr Setting<Config> kRigSettings[] = {
    {"file", &at<&Config::rig_file>},
};

inline constexpr Setting<Config> kBoothSettings[] = {
    {"every_slot", &at<&Config::booth_every_slot>},
    {"lights", &at<&Config::booth_lights>},
    {"shading", &at<&Config::booth_shading>},
};

inline constexpr Setting<pipeline::ShadingConfig> kModelSettings[] = {
    {"path", &at<&pipeline::ShadingConfig::model_file>},
    {"learn", &at<&pipeline::ShadingConfig::learn_live>},
    {"landmark_nets", &at<&pipeline::ShadingConfig::tracker, &track::TrackerConfig::landmark_nets>},
};

inline constexpr Setting<pipeline::LampsConfig> kLampsSettings[] = {
    {"active_low", &at<&pipeline::LampsConfig::active_low>},
    {"each_ms", &at<&pipeline::LampsConfig::each_ms>, 100, 5000},
};

inline constexpr Setting<pipeline::ShadingConfig> kGpuSettings[] = {
    {"device", &at<&pipeline::ShadingConfig::gpu_device>},
};

inline constexpr Setting<stream::StreamServerConfig> kStreamSettings[] = {
    {"socket", &at<&stream::StreamServerConfig::socket>},
    {"group", &at<&stream::StreamServerConfig::access, &stream::SocketAccess::group>},
};

inline constexpr Setting<ControlConfig> kControlSettings[] = {
    {"socket", &at<&ControlConfig::socket>},
    {"group", &at<&ControlConfig::access, &stream::SocketAccess::group>},
};

inline constexpr Setting<TakesConfig> kTakesSettings[] = {
    {"folder", &at<&TakesConfig::folder>},
    {"disk_reserve_mb", &at<&TakesConfig::disk_reserve_bytes>, 0, 1 << 30, kMebibyte},
    {"record_at_start", &at<&TakesConfig::record_at_start>},
    {"pictures", &at<&TakesConfig::pictures>},
};

inline constexpr Setting<sound::SoundConfig> kSoundSettings[] = {
    {"device", &at<&sound::SoundConfig::device>},
    {"rate_hz", &at<&sound::SoundConfig::rate_hz>, 8000, 192'000},
    {"channels", &at<&sound::SoundConfig::channels>, 1, 8},
    {"timecode_channel", &at<&sound::SoundConfig::timecode_channel>, 0, 8},
    {"record", &at<&sound::SoundConfig::record>},
};

inline constexpr Setting<OscConfig> kOscSettings[] = {
    {"public", &at<&OscConfig::is_public>},
};

inline constexpr Setting<avatar::BridgeConfig> kBridgesSettings[] = {
    {"rate_hz", &at<&avatar::BridgeConfig::rate_hz>, 1, 240},
    {"smoothing_ms", &at<&avatar::BridgeConfig::smoothing_ms>, 0, 10'000},
    {"subject", &at<&avatar::BridgeConfig::subject>},
    {"neutral", &at<&avatar::BridgeConfig::neutral_file>},
    {"vmc_eye_bones", &at<&avatar::BridgeConfig::vmc_eye_bones>},
    {"mapping", &at<&avatar::BridgeConfig::mapping_file>},
    {"answer", &at<&avatar::BridgeConfig::answer>},
    {"vtube_studio_arkit", &at<&avatar::BridgeConfig::vts_arkit>},
    {"vtube_studio_tokens", &at<&avatar::BridgeConfig::vts_tokens_file>},
};

inline constexpr Setting<WebConfig> kWebSettings[] = {
    {"page", &at<&WebConfig::page>},           {"public", &at<&WebConfig::is_public>},
    {"open_look", &at<&WebConfig::open_look>}, {"hosts", &at<&WebConfig::hosts>},
    {"origins", &at<&WebConfig::origins>},
};

/// Those of [expert.SECTION]: nobody at a booth can choose them.
namespace expert {

inline constexpr camera::CameraSetting kCamera[] = {camera::kBuffersSetting, camera::kStallAfterSetting};

inline constexpr Setting<pipeline::DevicesConfig> kTrigger[] = {
    {"tolerance_us", &at<&pipeline::DevicesConfig::program, &TriggerProgram::tolerance_ns>, 1, 1e6,
     kMicrosecond_ns},
    {"priority",
     &at<&pipeline::DevicesConfig::gpio, &trigger::GpioTriggerConfig::thread,
         &trigger::ThreadOptions::priority>,
     1, 99},
};

inline constexpr Setting<pipeline::DevicesConfig> kSets[] = {
    {"deadline_ms", &at<&pipeline::DevicesConfig::deadline_ms>, 0, 60'000},
};

inline constexpr Setting<track::TrackerConfig> kTracker[] = {
    {"acquisition_frames", &at<&track::TrackerConfig::acquisition_frames>, 1, 1000},
    {"expression_prior", &at<&track::TrackerConfig::expression_prior>, 0, 1000},
    {"temporal_prior", &at<&track::TrackerConfig::temporal_prior>, 0, 1000},
};

inline constexpr Setting<mesh::HierarchyOptions> kHierarchy[] = {
    {"min_edge_px", &at<&mesh::HierarchyOptions::min_edge_px>, 0.1, 1000},
    {"max_levels", &at<&mesh::HierarchyOptions::max_levels>, 1, 12},
    {"max_vertices", &at<&mesh::HierarchyOptions::max_vertices>, 1000, stream::kMaxVertices},
};

inline constexpr Setting<refine::RefinerConfig> kRefiner[] = {
    {"pcg_iterations", &at<&refine::RefinerConfig::pcg_iterations>, 1, 1000},
    {"albedo_frames", &at<&refine::RefinerConfig::albedo_frames>, 1, 10'000},
    {"robust_scale", &at<&refine::RefinerConfig::robust_scale>, 0, 1000},
    {"fold_slope", &at<&refine::RefinerConfig::fold_slope>, 0, 1000},
    {"displacement_bound_mm", &at<&refine::RefinerConfig::displacement_bound_mm>, 0.01, 1000},
};

inline constexpr Setting<refine::Weights> kWeights[] = {
    {"lighting_temporal", &at<&refine::Weights::lighting_temporal>, 0, 1e9},
    {"albedo_smooth", &at<&refine::Weights::albedo_smooth>, 0, 1e9},
    {"displacement_smooth", &at<&refine::Weights::displacement_smooth>, 0, 1e9},
    {"displacement_smooth_known", &at<&refine::Weights::displacement_smooth_known>, 0, 1e9},
    {"displacement_hierarchy", &at<&refine::Weights::displacement_hierarchy>, 0, 1e9},
    {"displacement_coarse", &at<&refine::Weights::displacement_coarse>, 0, 1e9},
    {"displacement_coarse_known", &at<&refine::Weights::displacement_coarse_known>, 0, 1e9},
};

inline constexpr Setting<stream::StreamServerConfig> kStream[] = {
    {"max_readers", &at<&stream::StreamServerConfig::max_readers>, 1, 1000},
};

inline constexpr Setting<TakesConfig> kTakes[] = {
    {"compression_level", &at<&TakesConfig::compression_level>, 1, 19},
};

inline constexpr Setting<WebConfig> kWeb[] = {
    {"max_readers", &at<&WebConfig::max_readers>, 1, 1000},
};

}  // namespace expert

/// Old spellings, read for one release more.
namespace renamed {

inline constexpr Setting<Config> kBooth[] = {{"rig", &at<&Config::rig_file>}};

inline constexpr Setting<pipeline::ShadingConfig> kModel[] = {
    {"landmark_assets", &at<&pipeline::ShadingConfig::tracker, &track::TrackerConfig::landmark_nets>}};

inline constexpr Setting<WebConfig> kWeb[] = {{"max_clients", &at<&WebConfig::max_readers>, 1, 1000}};

}  // namespace renamed

}  // namespace facet::service
