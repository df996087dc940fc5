// Any text is a mapping whose values are numbers for every face, and that is the same once it was saved, or
// an Error(Usage). So is any text alone as a formula.

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "avatar/mapping_file.hpp"
#include "facet/error.hpp"

namespace {

using namespace facet;

void check(const avatar::Formula& formula) {
  mesh::ArkitValues values{};
  for (const float value : {0.0F, 0.25F, 1.0F}) {
    values.fill(value);
    if (!std::isfinite(formula.of(values))) {
      std::abort();
    }
  }
  for (std::size_t i = 0; i < values.size(); ++i) {
    values.at(i) = static_cast<float>(i) / static_cast<float>(values.size());
  }
  if (!std::isfinite(formula.of(values))) {
    std::abort();
  }
}

template <typename Work>
void expect_usage(const Work& work) {
  try {
    work();
  } catch (const Error& error) {
    if (error.kind() != ErrorKind::Usage) {
      std::abort();
    }
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  expect_usage([&] { check(avatar::Formula(text)); });
  expect_usage([&] {
    const avatar::ValueMapping mapping = avatar::parse_mapping(text, "fuzz.toml");
    for (const avatar::MappedValues* table : {&mapping.vmc, &mapping.vrchat, &mapping.vtube_studio}) {
      for (const avatar::MappedValue& value : *table) {
        if (value.name.empty() || value.name.size() > avatar::kMostMappedNameBytes) {
          std::abort();
        }
        check(value.formula);
      }
    }
    if (!(avatar::parse_mapping(avatar::mapping_text(mapping), "again.toml") == mapping)) {
      std::abort();
    }
  });
  return 0;
}
