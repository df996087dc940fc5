#include "refine/refine_stage.hpp"

#include "gpu/context.hpp"

namespace facet::refine {
namespace {

class GpuStage final : public RefineStage {
 public:
  GpuStage(const std::string& device, const RefinerConfig& config)
      : context_(context_options(device)), refiner_(context_, config) {}

  std::string device() const override { return context_.info().name; }
  void set_subject(const SubjectSetup& subject) override { refiner_.set_subject(subject); }
  void restart() override { refiner_.restart(); }
  RefineOutcome refine(const RefineInput& input, RefineOutput& output) override {
    refiner_.submit(input);
    return refiner_.collect(output);
  }

 private:
  static gpu::ContextOptions context_options(const std::string& device) {
    gpu::ContextOptions options;
    options.device = device;
    return options;
  }

  gpu::Context context_;
  Refiner refiner_;
};

}  // namespace

OpenRefiner refiner_opener(const std::string& gpu_device, const RefinerConfig& config) {
  return [gpu_device, config] { return std::make_unique<GpuStage>(gpu_device, config); };
}

}  // namespace facet::refine
