#include "gpu/driver_files.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "support/paths.hpp"

namespace facet::gpu {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

/// A machine's files below a folder.
class DriverFilesTest : public ::testing::Test {
 protected:
  void make(const std::string& path, const std::string& text = {}) const {
    const std::filesystem::path file = folder_.path() / path;
    std::filesystem::create_directories(file.parent_path());
    std::ofstream(file) << text;
  }
  void remove(const std::string& path) const { std::filesystem::remove(folder_.path() / path); }

  std::vector<std::string> said(const std::vector<DeviceInfo>& found = {}) const {
    DriverPlaces places;
    places.root = folder_.path();
    places.library_path = library_path_;
    places.manifests = manifests_;
    return what_gpus_lack(found, places);
  }

  /// What a container with an NVIDIA GPU has by default: enough for CUDA.
  void make_cuda_only() const {
    make("dev/nvidiactl");
    make("dev/nvidia0");
    make("dev/nvidia-uvm");
    make("proc/driver/nvidia/version",
         "NVRM version: NVIDIA UNIX x86_64 Kernel Module  535.161.08  Sat Mar  2 01:03:58 UTC 2024\n");
    make("etc/ld.so.conf.d/x86_64-linux-gnu.conf", "# Multiarch support\n/usr/lib/x86_64-linux-gnu\n");
    make(libraries + "libcuda.so.535.161.08");
    make(libraries + "libnvidia-ml.so.535.161.08");
  }
  void make_whole() const {
    make_cuda_only();
    for (const char* name : {"libGLX_nvidia.so.0", "libEGL_nvidia.so.0", "libnvidia-glcore.so.535.161.08",
                             "libnvidia-eglcore.so.535.161.08", "libnvidia-glsi.so.535.161.08",
                             "libnvidia-tls.so.535.161.08", "libnvidia-glvkspirv.so.535.161.08",
                             "libnvidia-gpucomp.so.535.161.08", "libX11.so.6", "libXext.so.6"}) {
      make(libraries + name);
    }
    make(manifest, R"({"ICD": {"library_path": "libGLX_nvidia.so.0", "api_version": "1.3.242"}})");
  }

  static inline const std::string libraries = "usr/lib/x86_64-linux-gnu/";
  static inline const std::string manifest = "etc/vulkan/icd.d/nvidia_icd.json";
  std::string library_path_;
  std::string manifests_;

 private:
  test::TemporaryFolder folder_;
};

TEST_F(DriverFilesTest, AMachineWithoutAGpuLacksNothing) {
  EXPECT_THAT(said(), IsEmpty());
  make("usr/share/vulkan/icd.d/lvp_icd.x86_64.json", "libvulkan_lvp.so");
  make("sys/class/drm/renderD128/device/vendor", "0x1af4\n");  // of a virtual machine
  EXPECT_THAT(said(), IsEmpty());
}

TEST_F(DriverFilesTest, ACudaOnlyDriverIsNamedWithTheSwitchOfTheContainer) {
  make_cuda_only();
  EXPECT_THAT(said(), ElementsAre(AllOf(HasSubstr("/dev/nvidia0"), HasSubstr("CUDA-only"),
                                        HasSubstr("libGLX_nvidia.so.0"),
                                        HasSubstr("NVIDIA_DRIVER_CAPABILITIES=all"))));
  DeviceInfo software;
  software.type = DeviceType::Software;
  software.is_software = true;
  software.vendor_id = 0x10de;
  EXPECT_EQ(said({software}).size(), 1U) << "a software device is not the GPU";
}

TEST_F(DriverFilesTest, ADeviceThatIsThereIsNotMissed) {
  make_cuda_only();
  DeviceInfo found;
  found.type = DeviceType::Discrete;
  found.vendor_id = 0x10de;
  EXPECT_THAT(said({found}), IsEmpty());
}

TEST_F(DriverFilesTest, EachFileOfTheDriverIsMissedByName) {
  for (const char* name :
       {"libnvidia-glcore.so", "libnvidia-tls.so", "libnvidia-glvkspirv.so", "libnvidia-gpucomp.so"}) {
    make_whole();
    remove(libraries + name + ".535.161.08");
    EXPECT_THAT(said(),
                ElementsAre(AllOf(HasSubstr(std::string("lacks ") + name + ":"), HasSubstr("whole driver"))));
  }
  make_whole();
  remove(libraries + "libX11.so.6");
  EXPECT_THAT(said(), ElementsAre(AllOf(HasSubstr("lacks libX11.so.6"), HasSubstr("apt install libx11-6"))));
}

TEST_F(DriverFilesTest, TheEglLibraryHasNeedsOfItsOwn) {
  make_whole();
  make(manifest, R"({"ICD": {"library_path": "libEGL_nvidia.so.0"}})");
  remove(libraries + "libX11.so.6");
  remove(libraries + "libnvidia-glcore.so.535.161.08");
  EXPECT_THAT(said(), ElementsAre(HasSubstr("every file")));
  remove(libraries + "libnvidia-glsi.so.535.161.08");
  EXPECT_THAT(said(), ElementsAre(HasSubstr("lacks libnvidia-glsi.so")));
}

TEST_F(DriverFilesTest, AnOldDriverHasNoCompilerLibrary) {
  make_whole();
  make("proc/driver/nvidia/version", "NVRM version: NVIDIA UNIX x86_64 Kernel Module  525.60.13  2022\n");
  remove(libraries + "libnvidia-glvkspirv.so.535.161.08");
  make(libraries + "libnvidia-glvkspirv.so.525.60.13");
  remove(libraries + "libnvidia-gpucomp.so.535.161.08");
  EXPECT_THAT(said(), ElementsAre(HasSubstr("every file")));
}

TEST_F(DriverFilesTest, AManifestIsMissedWithWhatToWrite) {
  make_whole();
  remove(manifest);
  make("usr/share/vulkan/icd.d/lvp_icd.x86_64.json", "libvulkan_lvp.so");
  EXPECT_THAT(said(), ElementsAre(AllOf(HasSubstr("no manifest"), HasSubstr("nvidia_icd.json"),
                                        HasSubstr("\"library_path\": \"libGLX_nvidia.so.0\""))));
  make_whole();
  manifests_ = "/usr/share/vulkan/icd.d/lvp_icd.x86_64.json";
  EXPECT_THAT(said(), ElementsAre(HasSubstr("no manifest"))) << "VK_DRIVER_FILES names other drivers alone";
}

TEST_F(DriverFilesTest, AModuleOfAnotherVersionIsSaid) {
  make_whole();
  make("proc/driver/nvidia/version", "NVRM version: NVIDIA UNIX x86_64 Kernel Module  550.54.14  2024\n");
  EXPECT_THAT(said(),
              ElementsAre(AllOf(HasSubstr("550.54.14"), HasSubstr("535.161.08"), HasSubstr("restart"))));
}

TEST_F(DriverFilesTest, ModuleAndNodesAreMissed) {
  make("sys/class/drm/renderD128/device/vendor", "0x10de\n");
  EXPECT_THAT(said(), ElementsAre(AllOf(HasSubstr("no /dev/nvidia0"), HasSubstr("modprobe nvidia"))));
  make("proc/driver/nvidia/version", "NVRM version: NVIDIA UNIX x86_64 Kernel Module  535.161.08  2024\n");
  EXPECT_THAT(said(), ElementsAre(AllOf(HasSubstr("no /dev/nvidia0"), HasSubstr("--gpus all"))));
  make("dev/nvidia0");
  EXPECT_THAT(said(), ElementsAre(HasSubstr("no /dev/nvidiactl")));
}

TEST_F(DriverFilesTest, ADriverBesideThePathIsFound) {
  make_cuda_only();
  make("usr/local/nvidia/lib64/libGLX_nvidia.so.0");
  EXPECT_THAT(said(), ElementsAre(HasSubstr("LD_LIBRARY_PATH=/usr/local/nvidia/lib64")));
  library_path_ = "/usr/local/nvidia/lib64";
  EXPECT_THAT(said(),
              ElementsAre(AllOf(HasSubstr("lacks libnvidia-glvkspirv.so"), Not(HasSubstr("CUDA-only")))));
}

TEST_F(DriverFilesTest, MesasGpusAreMissedToo) {
  make("sys/class/drm/renderD128/device/vendor", "0x8086\n");
  make("sys/class/drm/renderD129/device/vendor", "0x1002\n");
  EXPECT_THAT(said(), ElementsAre(AllOf(HasSubstr("Intel"), HasSubstr("/dev/dri/renderD128"),
                                        HasSubstr("--device /dev/dri")),
                                  AllOf(HasSubstr("AMD"), HasSubstr("/dev/dri/renderD129"))));
  make("dev/dri/renderD128");
  make("dev/dri/renderD129");
  make("usr/share/vulkan/icd.d/radeon_icd.x86_64.json", "/usr/lib/x86_64-linux-gnu/libvulkan_radeon.so");
  EXPECT_THAT(said(), ElementsAre(AllOf(HasSubstr("Intel"), HasSubstr("apt install mesa-vulkan-drivers")),
                                  AllOf(HasSubstr("AMD"), HasSubstr("older than Vulkan 1.2"))));
}

TEST_F(DriverFilesTest, FilesOfNonsenseDoNoHarm) {
  make("sys/class/drm/renderD128/device/vendor", "0xzz");
  make("sys/class/drm/renderD129/device/vendor", "");
  make("proc/driver/nvidia/version", std::string(100'000, '.'));
  make("etc/ld.so.conf", std::string("\0\n/\n///\nrelative\n", 18));
  make("etc/vulkan/icd.d/broken.json", "{");
  make("dev/nvidiactl");
  EXPECT_THAT(said(), ElementsAre(HasSubstr("an NVIDIA GPU")));
}

}  // namespace
}  // namespace facet::gpu
