#include "animate/places.hpp"

#include <fmt/format.h>

#include <charconv>
#include <cmath>
#include <functional>
#include <limits>

#include "face/face_model.hpp"
#include "facet/error.hpp"

namespace facet::animate {
namespace {

using face::has_region;
using face::Region;

}  // namespace

std::vector<std::pair<std::string, std::int32_t>> places(const TakeBasis& basis) {
  const auto& regions = basis.sample().subject->regions;
  std::vector<std::pair<std::string, std::int32_t>> out;
  if (static_cast<int>(regions.size()) != basis.control_count()) {
    return out;
  }
  // Control vertices keep their number at every level.
  const mesh::Vertices& rest_mm = basis.rest_mm();
  using Judge = std::function<float(std::uint8_t bits, const Eigen::Vector3f& at)>;
  constexpr float kNever = -std::numeric_limits<float>::max();
  const auto best = [&](const Judge& judge) {
    std::int32_t found = -1;
    float most = kNever;
    for (std::int32_t v = 0; v < basis.control_count(); ++v) {
      const float value = judge(regions[static_cast<std::size_t>(v)], rest_mm.col(v));
      if (value > most) {
        most = value;
        found = v;
      }
    }
    return found;
  };
  const auto add = [&](const std::string& name, std::int32_t vertex) {
    if (vertex >= 0) {
      out.emplace_back(name, vertex);
    }
  };
  const std::int32_t left = best([&](std::uint8_t bits, const Eigen::Vector3f& at) {
    return has_region(bits, Region::Lips) ? at.x() : kNever;
  });
  const std::int32_t right = best([&](std::uint8_t bits, const Eigen::Vector3f& at) {
    return has_region(bits, Region::Lips) ? -at.x() : kNever;
  });
  if (left >= 0 && right >= 0) {
    const Eigen::Vector3f middle = 0.5F * (rest_mm.col(left) + rest_mm.col(right));
    constexpr float kAside_mm = 5;
    const auto in_middle = [&](const Eigen::Vector3f& at) {
      return std::abs(at.x() - middle.x()) < kAside_mm;
    };
    const auto lip = [&](float side) {
      return best([&, side](std::uint8_t bits, const Eigen::Vector3f& at) {
        const bool inside =
            has_region(bits, Region::Lips) && in_middle(at) && side * (at.y() - middle.y()) > 0;
        return inside ? at.z() : kNever;
      });
    };
    add("mouth-left", left);
    add("mouth-right", right);
    add("lip-upper", lip(1));
    add("lip-lower", lip(-1));
    constexpr float kBelow_mm = 15;
    add("chin", best([&](std::uint8_t bits, const Eigen::Vector3f& at) {
          const bool inside = has_region(bits, Region::Refinable) && !has_region(bits, Region::Lips) &&
                              in_middle(at) && at.y() < middle.y() - kBelow_mm;
          return inside ? at.z() : kNever;
        }));
  }
  add("nose", best([&](std::uint8_t bits, const Eigen::Vector3f& at) {
        return has_region(bits, Region::Refinable) ? at.z() : kNever;
      }));
  const float nose_x = out.empty() ? 0.0F : rest_mm(0, out.back().second);
  for (const float side : {1.0F, -1.0F}) {
    Eigen::Vector3f sum = Eigen::Vector3f::Zero();
    float count = 0;
    for (std::int32_t v = 0; v < basis.control_count(); ++v) {
      if (has_region(regions[static_cast<std::size_t>(v)], Region::Brow) &&
          side * (rest_mm(0, v) - nose_x) > 0) {
        sum += rest_mm.col(v);
        count += 1;
      }
    }
    if (count > 0) {
      const Eigen::Vector3f middle = sum / count;
      add(side > 0 ? "brow-left" : "brow-right", best([&](std::uint8_t bits, const Eigen::Vector3f& at) {
            return has_region(bits, Region::Brow) && has_region(bits, Region::Refinable)
                       ? -(at - middle).norm()
                       : kNever;
          }));
    }
  }
  return out;
}

std::int32_t find_vertex(const TakeBasis& basis, const std::string& text) {
  std::int32_t vertex = 0;
  const auto [stop, error] = std::from_chars(text.data(), text.data() + text.size(), vertex);
  if (error == std::errc() && stop == text.data() + text.size()) {
    return vertex;
  }
  std::string names;
  for (const auto& [name, at] : places(basis)) {
    if (name == text) {
      return at;
    }
    names += (names.empty() ? "" : ", ") + name;
  }
  throw Error(ErrorKind::Usage,
              fmt::format("'{}' is neither the number of a vertex nor a place; this take's mesh has {}", text,
                          names.empty() ? "no named places" : names));
}

}  // namespace facet::animate
