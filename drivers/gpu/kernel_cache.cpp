#include "gpu/kernel_cache.hpp"

#include <fmt/format.h>

#include <array>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <span>

#include "files/output_file.hpp"
#include "files/text_file.hpp"

namespace facet::gpu {

namespace {

// All kernels of this version take a few MB. A file that grew over many versions is begun anew.
constexpr std::size_t most_bytes = std::size_t{64} << 20U;

constexpr std::array<char, 16> magic{'f', 'a', 'c', 'e', 't', ' ', 'k', 'e',
                                     'r', 'n', 'e', 'l', 's', ' ', '1', '\n'};

struct Head {
  std::array<char, 16> magic{};
  KernelCacheKey key;
  std::uint64_t bytes = 0;     ///< of the driver's data, which follow
  std::uint64_t checksum = 0;  ///< of them
};
static_assert(sizeof(KernelCacheKey) == 48 && sizeof(Head) == 80);

/// FNV-1a, 64 bits.
std::uint64_t checksum_of(std::span<const std::byte> bytes) {
  std::uint64_t sum = 0xcbf29ce484222325U;
  for (const std::byte byte : bytes) {
    sum = (sum ^ std::to_integer<std::uint64_t>(byte)) * 0x100000001b3U;
  }
  return sum;
}

std::string file_name(const KernelCacheKey& key) {
  return fmt::format("kernels-{:016x}.cache", checksum_of(std::as_bytes(std::span(&key, 1))));
}

std::string variable(const char* name) {
  const char* value = std::getenv(name);
  return value == nullptr ? "" : value;
}

}  // namespace

std::filesystem::path kernel_cache_folder(const std::string& option) {
  if (option != "auto") {
    return option;
  }
  if (std::getenv("FACET_KERNEL_CACHE") != nullptr) {
    return variable("FACET_KERNEL_CACHE");
  }
  // Relative ones are to be ignored (XDG Base Directory Specification).
  if (const std::filesystem::path cache = variable("XDG_CACHE_HOME"); cache.is_absolute()) {
    return cache / "facet";
  }
  const std::filesystem::path home = variable("HOME");
  return home.is_absolute() ? home / ".cache" / "facet" : std::filesystem::path();
}

KernelCache::KernelCache(const DeviceApi& api, VkDevice device, const KernelCacheKey& key,
                         const std::filesystem::path& folder)
    : api_(api), device_(device), key_(key) {
  const Lock lock(mutex_);
  if (!folder.empty()) {
    state_.file = (folder / file_name(key)).string();
  }
  const std::vector<std::byte> data = read();
  if (!state_.why.empty()) {
    state_.ignored =
        fmt::format("the kernels compiled before, in '{}', are not used: {}", state_.file, state_.why);
  }
  VkPipelineCacheCreateInfo info{};
  info.sType = VK_STRUCTURE_TYPE_PIPELINE_CACHE_CREATE_INFO;
  info.initialDataSize = data.size();
  info.pInitialData = data.empty() ? nullptr : data.data();
  if (api_.vkCreatePipelineCache(device_, &info, nullptr, &cache_) != VK_SUCCESS) {
    cache_ = VK_NULL_HANDLE;  // kernels are compiled all the same
    state_.why = "the driver makes no pipeline cache";
    return;
  }
  state_.read_bytes = data.size();
  kept_bytes_ = data.size();
}

KernelCache::~KernelCache() {
  api_.vkDestroyPipelineCache(device_, cache_, nullptr);
}

KernelCacheState KernelCache::state() const {
  const Lock lock(mutex_);
  return state_;
}

/// The driver's data; empty where there are none that can be used.
std::vector<std::byte> KernelCache::read() {
  std::error_code error;
  if (state_.file.empty() || !std::filesystem::exists(state_.file, error)) {
    return {};
  }
  try {
    const files::InputFile in(state_.file, "kernel cache");
    if (!in.trusted()) {
      state_.why = "the file is not this user's or root's alone to write";
      return {};
    }
    std::vector<std::byte> bytes = in.read_all(most_bytes);
    Head head;
    if (bytes.size() < sizeof(head)) {
      state_.why = "the file is cut";
      return {};
    }
    std::memcpy(&head, bytes.data(), sizeof(head));
    bytes.erase(bytes.begin(), bytes.begin() + sizeof(head));
    if (head.magic != magic) {
      state_.why = "the file is none of kernels";
    } else if (head.key != key_) {
      state_.why = "the file is another driver's or device's";
    } else if (head.bytes != bytes.size() || head.checksum != checksum_of(bytes)) {
      state_.why = "the file is damaged";
    } else {
      return bytes;
    }
  } catch (const std::exception& failed) {
    state_.why = failed.what();
  }
  return {};
}

void KernelCache::write() {
  std::size_t size = 0;
  if (api_.vkGetPipelineCacheData(device_, cache_, &size, nullptr) != VK_SUCCESS || size == kept_bytes_) {
    return;
  }
  if (size > most_bytes - sizeof(Head)) {
    std::filesystem::remove(state_.file);  // the next start begins with nothing
    state_.why = "the kernels of many versions had grown too large and were forgotten";
    return;
  }
  std::vector<std::byte> data(size);
  if (api_.vkGetPipelineCacheData(device_, cache_, &size, data.data()) != VK_SUCCESS) {
    return;  // it grew meanwhile: another thread compiles, and keeps it when it is done
  }
  data.resize(size);
  const Head head{magic, key_, data.size(), checksum_of(data)};
  const std::filesystem::path file = state_.file;
  // Programs for the device, which a driver runs as they are: nobody else is to write them.
  files::make_folder(file.parent_path(), 0700);
  files::OutputFile out(file, 0600);
  out.write(std::as_bytes(std::span(&head, 1)));
  out.write(data);
  out.commit();
  kept_bytes_ = data.size();
  state_.written_bytes = data.size();
  state_.why.clear();
}

void KernelCache::keep() noexcept {
  const Lock lock(mutex_);
  if (cache_ == VK_NULL_HANDLE || state_.file.empty()) {
    return;
  }
  try {
    write();
  } catch (const std::exception& failed) {
    state_.why = failed.what();
  }
}

}  // namespace facet::gpu
