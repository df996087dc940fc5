#include "gpu/driver_files.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <optional>
#include <sstream>
#include <string_view>
#include <system_error>

namespace facet::gpu {

namespace {

namespace fs = std::filesystem;

constexpr std::uint32_t nvidia = 0x10de;
constexpr std::uint32_t amd = 0x1002;
constexpr std::uint32_t intel = 0x8086;
// The SPIR-V compiler's back end stands in a library of its own from this version of the driver on.
constexpr int first_with_gpucomp = 535;
constexpr std::size_t most_read_bytes = std::size_t{1} << 16U;

constexpr const char* show_the_gpu =
    "in a container, start it with the GPU's Vulkan part (NVIDIA_DRIVER_CAPABILITIES=all)";

/// Paths in a folder, sorted; none where there is no such folder.
std::vector<fs::path> entries(const fs::path& folder) {
  std::vector<fs::path> found;
  std::error_code error;
  for (fs::directory_iterator entry(folder, error), end; !error && entry != end; entry.increment(error)) {
    found.push_back(entry->path());
  }
  std::ranges::sort(found);
  return found;
}

bool is_there(const fs::path& path) {
  std::error_code error;
  return fs::exists(path, error);
}

/// The file's beginning; empty where it can't be read.
std::string beginning(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::string text(most_read_bytes, '\0');
  file.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<std::size_t>(std::max<std::streamsize>(file.gcount(), 0)));
  return text;
}

std::vector<fs::path> split(const std::string& list, char separator) {
  std::vector<fs::path> parts;
  std::istringstream stream(list);
  for (std::string part; std::getline(stream, part, separator);) {
    if (!part.empty()) {
      parts.emplace_back(part);
    }
  }
  return parts;
}

/// A root and what is looked up below it.
class Files {
 public:
  explicit Files(const DriverPlaces& places) : places_(places) {}

  fs::path at(const fs::path& path) const { return places_.root / path.relative_path(); }

  /// The folders in which the dynamic linker looks.
  std::vector<fs::path> library_folders() const {
    std::vector<fs::path> folders;
    for (const fs::path& folder : split(places_.library_path, ':')) {
      folders.push_back(at(folder));
    }
    std::vector<fs::path> lists = entries(at("etc/ld.so.conf.d"));
    lists.push_back(at("etc/ld.so.conf"));
    for (const fs::path& list : lists) {
      for (const fs::path& line : split(beginning(list), '\n')) {
        if (line.is_absolute()) {
          folders.push_back(at(line));
        }
      }
    }
    for (const char* folder : {"lib", "lib64", "usr/lib", "usr/lib64"}) {
      folders.push_back(at(folder));
    }
    for (const fs::path& folder : entries(at("usr/lib"))) {
      if (folder.filename().string().find("-linux-gnu") != std::string::npos) {
        folders.push_back(folder);
      }
    }
    return folders;
  }

  /// A library whose name begins so.
  static std::optional<fs::path> library(const std::vector<fs::path>& folders, std::string_view name) {
    for (const fs::path& folder : folders) {
      for (const fs::path& file : entries(folder)) {
        if (file.filename().string().starts_with(name)) {
          return file;
        }
      }
    }
    return std::nullopt;
  }

  std::vector<fs::path> manifests() const {
    std::vector<fs::path> found;
    const auto add = [&](const fs::path& file) {
      if (file.extension() == ".json") {
        found.push_back(file);
      }
    };
    if (!places_.manifests.empty()) {
      for (const fs::path& path : split(places_.manifests, ':')) {
        std::error_code error;
        if (fs::is_directory(at(path), error)) {
          std::ranges::for_each(entries(at(path)), add);
        } else if (is_there(at(path))) {
          add(at(path));
        }
      }
      return found;
    }
    for (const char* folder : {"usr/local/etc/vulkan/icd.d", "etc/vulkan/icd.d",
                               "usr/local/share/vulkan/icd.d", "usr/share/vulkan/icd.d"}) {
      std::ranges::for_each(entries(at(folder)), add);
    }
    return found;
  }

  /// Whether a manifest that is looked at names a library with one of these words in its name.
  bool manifest_names(std::initializer_list<std::string_view> words) const {
    return std::ranges::any_of(manifests(), [&](const fs::path& file) {
      const std::string text = beginning(file);
      return std::ranges::any_of(words,
                                 [&](std::string_view word) { return text.find(word) != std::string::npos; });
    });
  }

 private:
  const DriverPlaces& places_;
};

/// A GPU that the kernel knows.
struct KernelGpu {
  std::uint32_t vendor_id = 0;
  std::string node;    ///< renderD128
  std::string module;  ///< its kernel driver, where known
};

std::vector<KernelGpu> kernel_gpus(const Files& files) {
  std::vector<KernelGpu> found;
  for (const fs::path& entry : entries(files.at("sys/class/drm"))) {
    const std::string node = entry.filename().string();
    const std::string vendor = beginning(entry / "device/vendor");
    std::uint32_t id = 0;
    if (!node.starts_with("renderD") || !vendor.starts_with("0x") ||
        std::from_chars(vendor.data() + 2, vendor.data() + vendor.size(), id, 16).ec != std::errc{}) {
      continue;
    }
    std::error_code error;
    found.push_back({id, node, fs::read_symlink(entry / "device/driver", error).filename().string()});
  }
  return found;
}

/// "535.161.08" of the kernel module, empty where it is not loaded.
std::string nvidia_module_version(const Files& files) {
  std::istringstream words(beginning(files.at("proc/driver/nvidia/version")));
  for (std::string word; words >> word;) {
    const bool numbers = std::ranges::all_of(word, [](char c) { return c == '.' || (c >= '0' && c <= '9'); });
    if (numbers && std::ranges::count(word, '.') > 0) {
      return word;
    }
  }
  return {};
}

std::optional<std::string> nvidia_device_node(const Files& files) {
  for (const fs::path& entry : entries(files.at("dev"))) {
    const std::string name = entry.filename().string();
    constexpr std::string_view prefix = "nvidia";
    if (name.starts_with(prefix) && name.size() > prefix.size() && name[prefix.size()] >= '0' &&
        name[prefix.size()] <= '9') {
      return "/dev/" + name;
    }
  }
  return std::nullopt;
}

/// What of the driver's own libraries is missing, of those that vkCreateInstance opens.
std::vector<std::string> missing_nvidia_libraries(const std::vector<fs::path>& folders, bool by_glx,
                                                  int major) {
  std::vector<std::string> needed{"libnvidia-glvkspirv.so", "libnvidia-tls.so"};
  if (by_glx) {
    needed.insert(needed.end(), {"libnvidia-glcore.so", "libX11.so.6", "libXext.so.6"});
  } else {
    needed.insert(needed.end(), {"libnvidia-eglcore.so", "libnvidia-glsi.so"});
  }
  if (major >= first_with_gpucomp) {
    needed.emplace_back("libnvidia-gpucomp.so");
  }
  std::erase_if(needed, [&](const std::string& name) { return Files::library(folders, name).has_value(); });
  return needed;
}

std::optional<std::string> what_nvidia_lacks(const Files& files, const std::vector<KernelGpu>& gpus) {
  const auto seen = std::ranges::find(gpus, nvidia, &KernelGpu::vendor_id);
  const std::string version = nvidia_module_version(files);
  const std::optional<std::string> node = nvidia_device_node(files);
  const bool control = is_there(files.at("dev/nvidiactl"));
  if (seen == gpus.end() && version.empty() && !node && !control) {
    return std::nullopt;
  }
  if (seen != gpus.end() && seen->module == "nouveau") {
    return "an NVIDIA GPU, driven by nouveau, which is no Vulkan device in Debian 12: install NVIDIA's own "
           "driver "
           "(Debian: apt install nvidia-driver nvidia-vulkan-icd)";
  }
  if (!node || !control) {
    return fmt::format("an NVIDIA GPU, but no {}: {}", node ? "/dev/nvidiactl" : "/dev/nvidia0",
                       version.empty() ? "its kernel module is not loaded (modprobe nvidia)"
                                       : "give the container the GPU (--gpus all)");
  }
  const std::string gpu = fmt::format("an NVIDIA GPU ({})", *node);
  const std::vector<fs::path> folders = files.library_folders();
  const std::optional<fs::path> glx = Files::library(folders, "libGLX_nvidia.so.0");
  const std::optional<fs::path> egl = Files::library(folders, "libEGL_nvidia.so.0");
  if (!glx && !egl) {
    for (const char* aside : {"usr/local/nvidia/lib64", "usr/local/nvidia/lib", "usr/lib/wsl/lib"}) {
      if (Files::library({files.at(aside)}, "libGLX_nvidia.so.0")) {
        return fmt::format("{}: its driver lies in /{}, where nobody looks: set LD_LIBRARY_PATH=/{}", gpu,
                           aside, aside);
      }
    }
    return fmt::format(
        "{}, but a CUDA-only driver (neither libGLX_nvidia.so.0 nor libEGL_nvidia.so.0): {}; on "
        "a host, install the driver's Vulkan part (Debian: apt install nvidia-vulkan-icd)",
        gpu, show_the_gpu);
  }
  int major = 0;
  std::from_chars(version.data(), version.data() + version.size(), major);
  // Debian's manifest names the GLX library; the EGL one serves without X.
  const bool by_glx = glx && (!egl || !files.manifest_names({"libEGL_nvidia"}));
  const std::vector<std::string> missing = missing_nvidia_libraries(folders, by_glx, major);
  if (!missing.empty()) {
    const bool host_library =
        std::ranges::all_of(missing, [](const std::string& name) { return name.starts_with("libX"); });
    return fmt::format("{}, whose driver lacks {}: {}", gpu, fmt::join(missing, ", "),
                       host_library ? "apt install libx11-6 libxext6"
                                    : fmt::format("{}; on a host, install the whole driver", show_the_gpu));
  }
  const std::optional<fs::path> compiler = Files::library(folders, "libnvidia-glvkspirv.so.");
  if (compiler && !version.empty() && compiler->filename().string().find(version) == std::string::npos) {
    return fmt::format(
        "{}: its kernel module is of version {}, but there is {}: restart after an update of the "
        "driver; a container takes the host's driver",
        gpu, version, compiler->filename().string());
  }
  if (!files.manifest_names({"libGLX_nvidia", "libEGL_nvidia"})) {
    return fmt::format(
        "{}, but no manifest that the Vulkan loader looks at names its driver: write "
        "/etc/vulkan/icd.d/nvidia_icd.json with {{\"file_format_version\": \"1.0.0\", \"ICD\": "
        "{{\"library_path\": \"{}\", \"api_version\": \"1.3.0\"}}}}, or set VK_DRIVER_FILES to one",
        gpu, glx ? "libGLX_nvidia.so.0" : "libEGL_nvidia.so.0");
  }
  return fmt::format(
      "{}: every file of its driver that Facet knows is there, and still it gives no device; "
      "VK_LOADER_DEBUG=all facet doctor shows what the loader says",
      gpu);
}

/// Of AMD's and Intel's, whose Vulkan drivers are Mesa's.
std::optional<std::string> what_mesa_lacks(const Files& files, const KernelGpu& gpu) {
  const bool is_amd = gpu.vendor_id == amd;
  const std::string name = fmt::format("{} GPU (/dev/dri/{})", is_amd ? "an AMD" : "an Intel", gpu.node);
  const fs::path node = files.at("dev/dri") / gpu.node;
  if (!is_there(node)) {
    return fmt::format("{}, whose device node is not there: give the container the GPU (--device /dev/dri)",
                       name);
  }
  if (::access(node.c_str(), R_OK | W_OK) != 0) {
    return fmt::format(
        "{}, which this user may not open: add the user to the group 'render' (usermod -aG render "
        "USER) and log in again",
        name);
  }
  const bool named = is_amd ? files.manifest_names({"libvulkan_radeon", "amdvlk"})
                            : files.manifest_names({"libvulkan_intel"});
  if (!named) {
    return fmt::format(
        "{}, but no manifest that the Vulkan loader looks at names its driver: apt install "
        "mesa-vulkan-drivers; where VK_DRIVER_FILES or VK_ICD_FILENAMES is set, it must name one",
        name);
  }
  return fmt::format(
      "{}, of which its driver makes no device: it may be older than Vulkan 1.2 or newer than the "
      "installed Mesa; VK_LOADER_DEBUG=all facet doctor shows what the loader says",
      name);
}

std::string variable(const char* name) {
  const char* value = std::getenv(name);
  return value == nullptr ? "" : value;
}

}  // namespace

DriverPlaces DriverPlaces::here() {
  DriverPlaces places;
  places.library_path = variable("LD_LIBRARY_PATH");
  places.manifests = variable("VK_DRIVER_FILES");
  if (places.manifests.empty()) {
    places.manifests = variable("VK_ICD_FILENAMES");
  }
  return places;
}

std::vector<std::string> what_gpus_lack(const std::vector<DeviceInfo>& found, const DriverPlaces& places) {
  const auto is_found = [&](std::uint32_t vendor) {
    return std::ranges::any_of(
        found, [&](const DeviceInfo& info) { return info.vendor_id == vendor && !info.is_software; });
  };
  const Files files(places);
  const std::vector<KernelGpu> gpus = kernel_gpus(files);
  std::vector<std::string> said;
  const auto say = [&](const std::optional<std::string>& sentence) {
    if (sentence) {
      said.push_back(*sentence);
    }
  };
  if (!is_found(nvidia)) {
    say(what_nvidia_lacks(files, gpus));
  }
  for (const KernelGpu& gpu : gpus) {
    if ((gpu.vendor_id == amd || gpu.vendor_id == intel) && !is_found(gpu.vendor_id)) {
      say(what_mesa_lacks(files, gpu));
    }
  }
  return said;
}

}  // namespace facet::gpu
