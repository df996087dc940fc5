#include "refine/refine_stage.hpp"

#include "gpu/context.hpp"

namespace facet::refine {
namespace {

class GpuStage final : public RefineStage {
 public:
  GpuStage(const gpu::ContextOptions& options, const RefinerConfig& config)
      : context_(options), refiner_(context_, config) {}

  std::string device() const override { return context_.info().name; }
  std::string kernels_ignored() const override { return context_.kernel_cache().ignored; }
  void set_subject(const SubjectSetup& subject) override { refiner_.set_subject(subject); }
  void restart() override { refiner_.restart(); }
  RefineOutcome refine(const RefineInput& input, RefineOutput& output) override {
    refiner_.submit(input);
    return refiner_.collect(output);
  }

 private:
  gpu::Context context_;
  Refiner refiner_;
};

}  // namespace

OpenRefiner refiner_opener(const gpu::ContextOptions& options, const RefinerConfig& config) {
  return [options, config] { return std::make_unique<GpuStage>(options, config); };
}

}  // namespace facet::refine
