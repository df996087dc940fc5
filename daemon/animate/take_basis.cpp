#include "animate/take_basis.hpp"

#include <fmt/format.h>

#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <future>
#include <limits>
#include <map>
#include <numeric>
#include <optional>
#include <string>

#include "animate/streaming_basis.hpp"
#include "face/face_model.hpp"
#include "facet/error.hpp"
#include "files/output_file.hpp"
#include "maths/statistics.hpp"
#include "take/reader.hpp"

namespace facet::animate {
namespace {

constexpr int kBlock = 64;
/// Directions that are kept besides the wanted ones while blocks come, so that a late frame can still lift
/// them.
constexpr int kSpareDirections = 16;
constexpr int kLeastFrames = 3;
constexpr int kLeastEyeVertices = 12;
/// A frame follows the one before it where no more than this many periods lie between them.
constexpr double kMostGap = 1.5;

/// 0, or 1 + the eyeball, per control vertex. Pieces are joined by the stencils of the coarsest level.
std::vector<std::uint8_t> find_eyeballs(const mesh::Subject& subject, int& eye_count) {
  const mesh::Hierarchy& hierarchy = *subject.hierarchy;
  const auto count = static_cast<std::size_t>(hierarchy.control_vertex_count);
  std::vector<std::uint8_t> eye_of_vertex(count, 0);
  eye_count = 0;
  if (subject.regions.size() != count) {
    return eye_of_vertex;
  }
  std::vector<std::size_t> piece(count);
  std::iota(piece.begin(), piece.end(), std::size_t{0});
  const auto root = [&](std::size_t v) {
    while (piece[v] != v) {
      v = piece[v] = piece[piece[v]];
    }
    return v;
  };
  const auto join = [&](std::int32_t a, std::int32_t b) {
    const auto limit = static_cast<std::int32_t>(count);
    if (a < limit && b < limit) {
      piece[root(static_cast<std::size_t>(a))] = root(static_cast<std::size_t>(b));
    }
  };
  const mesh::Level& coarsest = hierarchy.levels.front();
  for (std::int32_t row = 0; row < coarsest.from_coarser.row_count(); ++row) {
    const auto at = static_cast<std::size_t>(row);
    const std::int32_t first = coarsest.from_coarser.row_offsets[at];
    for (std::int32_t k = first; k < coarsest.from_coarser.row_offsets[at + 1]; ++k) {
      join(coarsest.from_coarser.columns[static_cast<std::size_t>(first)],
           coarsest.from_coarser.columns[static_cast<std::size_t>(k)]);
    }
  }
  if (coarsest.vertex_count == hierarchy.control_vertex_count) {
    for (Eigen::Index t = 0; t < coarsest.triangles.cols(); ++t) {
      join(coarsest.triangles(0, t), coarsest.triangles(1, t));
      join(coarsest.triangles(0, t), coarsest.triangles(2, t));
    }
  }
  std::map<std::size_t, std::pair<int, bool>> pieces;  // vertices, and whether all are of the eye
  for (std::size_t v = 0; v < count; ++v) {
    auto& [vertices, only_eye] = pieces.try_emplace(root(v), 0, true).first->second;
    ++vertices;
    only_eye = only_eye && face::has_region(subject.regions[v], face::Region::Eye);
  }
  std::map<std::size_t, std::uint8_t> eyeballs;
  for (const auto& [at, found] : pieces) {
    if (found.second && found.first >= kLeastEyeVertices && eye_count < kMaxEyes) {
      eyeballs[at] = static_cast<std::uint8_t>(++eye_count);
    }
  }
  for (std::size_t v = 0; v < count; ++v) {
    const auto found = eyeballs.find(root(v));
    eye_of_vertex[v] = found != eyeballs.end() ? found->second : std::uint8_t{0};
  }
  return eye_of_vertex;
}

/// The rotation vector and the shift of the middle that carry one eyeball's resting vertices closest to where
/// they are [Kab76].
Eigen::Matrix<float, 6, 1> rigid_motion(const mesh::Vertices& resting, const mesh::Vertices& moved) {
  const Eigen::Vector3f from = resting.rowwise().mean();
  const Eigen::Vector3f to = moved.rowwise().mean();
  const Eigen::Matrix3f spread = (moved.colwise() - to) * (resting.colwise() - from).transpose();
  const Eigen::JacobiSVD<Eigen::Matrix3f> svd(spread, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3f signs(1, 1, 1);
  signs.z() = (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0 ? -1.0F : 1.0F;
  const Eigen::AngleAxisf turn(
      Eigen::Matrix3f(svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose()));
  Eigen::Matrix<float, 6, 1> motion;
  motion << turn.angle() * turn.axis(), to - from;
  return motion;
}

struct Eyeball {
  std::vector<Eigen::Index> vertices;
  mesh::Vertices resting_mm;
};

mesh::Vertices columns(const mesh::Vertices& from, const std::vector<Eigen::Index>& which) {
  return from(Eigen::all, which);
}

float blink_of(const mesh::MeshFrame& frame) {
  float blink = 0;
  const auto& names = frame.subject->expression_names;
  for (std::size_t e = 0; e < std::min(names.size(), frame.expression.size()); ++e) {
    if (names[e] == "eyeBlinkLeft" || names[e] == "eyeBlinkRight") {
      blink = std::max(blink, frame.expression[e]);
    }
  }
  return std::clamp(blink, 0.0F, 1.0F);
}

/// Reads the take twice and makes the bytes of its basis.
class Builder {
 public:
  Builder(const std::filesystem::path& take, const BasisOptions& options, const BasisProgress& progress)
      : take_(take), options_(options), progress_(progress), reader_(take) {}

  BasisBytes build(const FileState& state) {
    find_directions();
    find_coefficients();
    return pack(state);
  }

 private:
  [[noreturn]] void refuse(const std::string& what) const {
    throw Error(ErrorKind::UnreadableInput, fmt::format("take '{}' {}", take_.string(), what));
  }

  void tell(std::int64_t done) const {
    if (progress_ && !progress_(done, 2 * reader_.frame_count())) {
      throw Error(ErrorKind::Unavailable, "broken off");
    }
  }

  /// A frame's mesh, checked; null where it has none.
  std::shared_ptr<const mesh::MeshFrame> read(std::int64_t index) {
    if (!reader_.entry(index).has_mesh) {
      return nullptr;
    }
    auto frame = reader_.frame(index, take::Pictures::Described);
    if (!mesh::has_mesh(*frame)) {
      return nullptr;
    }
    if (subject_ == nullptr) {
      begin(*frame);
    } else if (!mesh::same_topology(*frame->subject->hierarchy, *subject_->hierarchy)) {
      refuse(fmt::format(
          "has meshes of more than one topology: frame {} is of another than frame {} (another person, or "
          "the same one acquired anew); process the footage of each apart, with --frames",
          frame->sequence, first_sequence_));
    }
    if (!frame->control_vertices_mm.allFinite()) {
      refuse(fmt::format("has vertices that are not finite in frame {}", frame->sequence));
    }
    return frame;
  }

  void begin(const mesh::MeshFrame& frame) {
    subject_ = frame.subject;
    first_sequence_ = frame.sequence;
    reference_ = frame.control_vertices_mm;
    const auto& hierarchy = *subject_->hierarchy;
    int eye_count = 0;
    eye_of_vertex_ = find_eyeballs(*subject_, eye_count);
    eyes_.resize(static_cast<std::size_t>(eye_count));
    for (std::size_t v = 0; v < eye_of_vertex_.size(); ++v) {
      if (eye_of_vertex_[v] > 0) {
        eyes_[eye_of_vertex_[v] - 1U].vertices.push_back(static_cast<Eigen::Index>(v));
      }
    }
    for (Eyeball& eye : eyes_) {
      eye.resting_mm = columns(reference_, eye.vertices);
    }
    coarse_.emplace(reference_.size(), options_.coarse_rank + kSpareDirections);
    detail_.emplace(hierarchy.finest().vertex_count,
                    options_.detail_rank > 0 ? options_.detail_rank + kSpareDirections : 0);
  }

  bool has_detail(const mesh::MeshFrame& frame) const {
    return static_cast<std::int32_t>(frame.displacements_mm.size()) ==
           subject_->hierarchy->finest().vertex_count;
  }

  /// Control vertices minus the reference, without the eyeballs.
  Eigen::VectorXf coarse_offset(const mesh::MeshFrame& frame) const {
    mesh::Vertices offset = frame.control_vertices_mm - reference_;
    for (const Eyeball& eye : eyes_) {
      for (const Eigen::Index v : eye.vertices) {
        offset.col(v).setZero();
      }
    }
    return Eigen::Map<const Eigen::VectorXf>(offset.data(), offset.size());
  }
  static Eigen::VectorXf detail_of(const mesh::MeshFrame& frame) {
    Eigen::VectorXf detail = Eigen::Map<const Eigen::VectorXf>(
        frame.displacements_mm.data(), static_cast<Eigen::Index>(frame.displacements_mm.size()));
    return detail.unaryExpr([](float value) { return std::isfinite(value) ? value : 0.0F; });
  }

  /// First reading: the strongest directions, in blocks; while one is worked in the next is read.
  void find_directions() {
    Eigen::MatrixXf coarse_block;
    Eigen::MatrixXf detail_block;
    Eigen::Index coarse_filled = 0;
    Eigen::Index detail_filled = 0;
    std::future<void> coarse_work;
    std::future<void> detail_work;
    const auto wait = [&] {
      for (std::future<void>* work : {&coarse_work, &detail_work}) {
        if (work->valid()) {
          work->get();
        }
      }
    };
    const auto hand_over = [&] {
      wait();
      coarse_work = std::async(
          std::launch::async,
          [this, block = Eigen::MatrixXf(coarse_block.leftCols(coarse_filled))] { coarse_->add(block); });
      detail_work = std::async(
          std::launch::async,
          [this, block = Eigen::MatrixXf(detail_block.leftCols(detail_filled))] { detail_->add(block); });
      coarse_filled = 0;
      detail_filled = 0;
    };
    for (std::int64_t index = 0; index < reader_.frame_count(); ++index) {
      const auto frame = read(index);
      if (frame != nullptr) {
        if (coarse_block.cols() == 0) {
          coarse_block.resize(reference_.size(), kBlock);
          detail_block.resize(subject_->hierarchy->finest().vertex_count, kBlock);
        }
        coarse_block.col(coarse_filled++) = coarse_offset(*frame);
        ++meshes_;
        if (has_detail(*frame)) {
          detail_block.col(detail_filled++) = detail_of(*frame);
          ++refined_;
        }
        if (coarse_filled == kBlock) {
          hand_over();
        }
      }
      tell(index + 1);
    }
    if (subject_ == nullptr) {
      refuse("has no meshes: no face was tracked in it, or it was recorded without");
    }
    hand_over();
    wait();
    with_detail_ = 2 * refined_ > meshes_ && options_.detail_rank > 0;
    if ((with_detail_ ? refined_ : meshes_) < kLeastFrames) {
      refuse(
          fmt::format("has {} mesh{}; posing and animating need {} at least, and are of use from some "
                      "seconds of a moving face on",
                      meshes_, meshes_ == 1 ? "" : "es", kLeastFrames));
    }
    coarse_directions_ = coarse_->directions();
    coarse_directions_.conservativeResize(
        Eigen::NoChange, std::min<Eigen::Index>(coarse_directions_.cols(), options_.coarse_rank));
    detail_directions_ =
        with_detail_ ? detail_->directions() : Eigen::MatrixXf(subject_->hierarchy->finest().vertex_count, 0);
    detail_directions_.conservativeResize(
        Eigen::NoChange, std::min<Eigen::Index>(detail_directions_.cols(), options_.detail_rank));
    coarse_.reset();
    detail_.reset();
  }

  /// Second reading: each frame's coefficients, and how far they are from the frame.
  void find_coefficients() {
    const Eigen::Index eye_offset = coarse_directions_.cols() + detail_directions_.cols();
    const auto eye_numbers = static_cast<Eigen::Index>(6 * eyes_.size());
    const auto expressions = static_cast<Eigen::Index>(subject_->expression_names.size());
    coefficients_.resize(eye_offset + eye_numbers + expressions, with_detail_ ? refined_ : meshes_);
    coefficients_.setZero();
    double coarse_squares = 0;
    double detail_squares = 0;
    float worst_mm = -1;
    Eigen::Index at = 0;
    for (std::int64_t index = 0; index < reader_.frame_count(); ++index) {
      tell(reader_.frame_count() + index);
      const auto frame = read(index);
      if (frame == nullptr || (with_detail_ && !has_detail(*frame))) {
        continue;
      }
      if (at == coefficients_.cols()) {
        refuse("grew while it was read");
      }
      auto column = coefficients_.col(at);
      const Eigen::VectorXf offset = coarse_offset(*frame);
      column.head(coarse_directions_.cols()) = coarse_directions_.transpose() * offset;
      Eigen::VectorXf rest = offset - coarse_directions_ * column.head(coarse_directions_.cols());
      for (std::size_t e = 0; e < eyes_.size(); ++e) {
        const mesh::Vertices moved = columns(frame->control_vertices_mm, eyes_[e].vertices);
        const auto motion = rigid_motion(eyes_[e].resting_mm, moved);
        column.segment<6>(eye_offset + 6 * static_cast<Eigen::Index>(e)) = motion;
        const Eigen::Vector3f middle = eyes_[e].resting_mm.rowwise().mean();
        const Eigen::AngleAxisf turn(motion.head<3>().norm(), motion.head<3>().stableNormalized());
        for (std::size_t k = 0; k < eyes_[e].vertices.size(); ++k) {
          const auto v = static_cast<Eigen::Index>(k);
          const Eigen::Vector3f rigid =
              turn * Eigen::Vector3f(eyes_[e].resting_mm.col(v) - middle) + middle + motion.tail<3>();
          rest.segment<3>(3 * eyes_[e].vertices[k]) = moved.col(v) - rigid;
        }
      }
      const float coarse_mm = std::sqrt(Eigen::Map<const mesh::Vertices>(rest.data(), 3, rest.size() / 3)
                                            .colwise()
                                            .squaredNorm()
                                            .maxCoeff());
      coarse_squares += static_cast<double>(rest.squaredNorm()) * 3.0 / static_cast<double>(rest.size());
      float detail_mm = 0;
      if (with_detail_) {
        const Eigen::VectorXf detail = detail_of(*frame);
        column.segment(coarse_directions_.cols(), detail_directions_.cols()) =
            detail_directions_.transpose() * detail;
        const Eigen::VectorXf left = detail - detail_directions_ * column.segment(coarse_directions_.cols(),
                                                                                  detail_directions_.cols());
        detail_mm = left.cwiseAbs().maxCoeff();
        detail_squares += static_cast<double>(left.squaredNorm()) / static_cast<double>(left.size());
      }
      for (Eigen::Index e = 0;
           e < std::min<Eigen::Index>(expressions, static_cast<Eigen::Index>(frame->expression.size()));
           ++e) {
        column[eye_offset + eye_numbers + e] = frame->expression[static_cast<std::size_t>(e)];
      }
      header_.coarse_max_mm = std::max(header_.coarse_max_mm, coarse_mm);
      header_.detail_max_mm = std::max(header_.detail_max_mm, detail_mm);
      if (coarse_mm + detail_mm > worst_mm) {
        worst_mm = coarse_mm + detail_mm;
        header_.worst_frame = static_cast<std::int32_t>(index);
      }
      add_frame(*frame, index);
      ++at;
    }
    if (at != coefficients_.cols()) {
      refuse("changed while it was read");
    }
    header_.coarse_rms_mm = static_cast<float>(std::sqrt(coarse_squares / static_cast<double>(at)));
    header_.detail_rms_mm = static_cast<float>(std::sqrt(detail_squares / static_cast<double>(at)));
    mark_sequence();
  }

  void add_frame(const mesh::MeshFrame& frame, std::int64_t index) {
    CapturedFrame captured;
    captured.index = index;
    captured.sequence = static_cast<std::int64_t>(frame.sequence);
    captured.media_time_ns = frame.media_time_ns;
    timestamps_ns_.push_back(frame.timestamp_ns);
    for (int row = 0; row < 3; ++row) {
      for (int column = 0; column < 4; ++column) {
        const float value = frame.camera_from_head(row, column);
        captured.camera_from_head[static_cast<std::size_t>(4 * row + column)] =
            std::isfinite(value) ? value : 0.0F;
      }
    }
    captured.blink = blink_of(frame);
    frames_.push_back(captured);
  }

  /// Which frames follow the one before, by the median period.
  void mark_sequence() {
    const auto same_time = [&](const CapturedFrame& frame) {
      return frame.media_time_ns == frames_.front().media_time_ns;
    };
    if (std::all_of(frames_.begin(), frames_.end(), same_time)) {  // a source without a time of its own
      for (std::size_t f = 0; f < frames_.size(); ++f) {
        frames_[f].media_time_ns = timestamps_ns_[f];
      }
    }
    std::vector<double> periods_s;
    for (std::size_t f = 1; f < frames_.size(); ++f) {
      periods_s.push_back(static_cast<double>(frames_[f].media_time_ns - frames_[f - 1].media_time_ns) *
                          1e-9);
    }
    const double median_s = maths::median_of(std::vector(periods_s));
    header_.frame_period_s = median_s > 1e-4 && median_s < 10 ? median_s : 1.0 / 30;
    for (std::size_t f = 1; f < frames_.size(); ++f) {
      frames_[f].follows =
          periods_s[f - 1] > 0 && periods_s[f - 1] < kMostGap * header_.frame_period_s ? 1 : 0;
    }
    const auto& names = subject_->expression_names;
    header_.blinks_known = std::find(names.begin(), names.end(), "eyeBlinkLeft") != names.end() ? 1 : 0;
  }

  BasisBytes pack(const FileState& state) {
    const mesh::Hierarchy& hierarchy = *subject_->hierarchy;
    header_.take = state;
    header_.subject_id = subject_->id;
    header_.hierarchy_id = hierarchy.id;
    header_.control_vertex_count = hierarchy.control_vertex_count;
    header_.finest_vertex_count = hierarchy.finest().vertex_count;
    header_.coarse_rank = static_cast<std::int32_t>(coarse_directions_.cols());
    header_.detail_rank = static_cast<std::int32_t>(detail_directions_.cols());
    header_.wanted_coarse_rank = options_.coarse_rank;
    header_.wanted_detail_rank = options_.detail_rank;
    header_.eye_count = static_cast<std::int32_t>(eyes_.size());
    header_.expression_count = static_cast<std::int32_t>(subject_->expression_names.size());
    header_.frame_count = static_cast<std::int32_t>(frames_.size());
    header_.left_out = static_cast<std::int32_t>(meshes_ - static_cast<std::int64_t>(frames_.size()));

    const Eigen::VectorXf means = coefficients_.rowwise().mean();
    coefficients_.colwise() -= means;
    const Eigen::Index eye_offset = coarse_directions_.cols() + detail_directions_.cols();
    const auto eye_numbers = static_cast<Eigen::Index>(6 * eyes_.size());
    Eigen::VectorXf coarse_mean = Eigen::Map<const Eigen::VectorXf>(reference_.data(), reference_.size());
    coarse_mean += coarse_directions_ * means.head(coarse_directions_.cols());
    const Eigen::VectorXf detail_mean =
        detail_directions_ * means.segment(coarse_directions_.cols(), detail_directions_.cols());
    const Eigen::MatrixXf coarse = coarse_directions_.transpose();
    const Eigen::MatrixXf detail = detail_directions_.transpose();
    std::vector<mesh::Vertices> levels;
    mesh::push_positions(hierarchy,
                         Eigen::Map<const mesh::Vertices>(coarse_mean.data(), 3, reference_.cols()), levels);
    const Eigen::MatrixXf folds = narrow_part(hierarchy, levels.back(), detail);

    BasisBytes bytes = make_basis_bytes(header_);
    const BasisSections parts = unsealed_sections(bytes);
    const auto fill = [](const auto* part, const auto* from, std::size_t count) {
      if (count > 0) {
        std::memcpy(const_cast<std::remove_const_t<std::remove_pointer_t<decltype(part)>>*>(part), from,
                    count * sizeof(*from));
      }
    };
    const auto fill_matrix = [&](const float* part, const auto& matrix) {
      fill(part, matrix.data(), static_cast<std::size_t>(matrix.size()));
    };
    fill(parts.frames, frames_.data(), frames_.size());
    fill_matrix(parts.coefficients, coefficients_);
    fill_matrix(parts.coarse, coarse);
    fill_matrix(parts.detail, detail);
    fill_matrix(parts.folds, folds);
    fill_matrix(parts.coarse_mean, coarse_mean);
    fill_matrix(parts.detail_mean, detail_mean);
    fill_matrix(parts.eye_means, Eigen::VectorXf(means.segment(eye_offset, eye_numbers)));
    fill_matrix(parts.expression_means, Eigen::VectorXf(means.tail(means.size() - eye_offset - eye_numbers)));
    fill(parts.eye_of_vertex, eye_of_vertex_.data(), eye_of_vertex_.size());
    seal_basis(bytes);
    return bytes;
  }

  const std::filesystem::path& take_;
  const BasisOptions& options_;
  const BasisProgress& progress_;
  take::TakeReader reader_;
  std::shared_ptr<const mesh::Subject> subject_;
  std::uint64_t first_sequence_ = 0;
  mesh::Vertices reference_;
  std::vector<std::uint8_t> eye_of_vertex_;
  std::vector<Eyeball> eyes_;
  std::optional<StreamingBasis> coarse_;
  std::optional<StreamingBasis> detail_;
  std::int64_t meshes_ = 0;
  std::int64_t refined_ = 0;
  bool with_detail_ = false;
  Eigen::MatrixXf coarse_directions_;
  Eigen::MatrixXf detail_directions_;
  Eigen::MatrixXf coefficients_;
  std::vector<CapturedFrame> frames_;
  std::vector<std::int64_t> timestamps_ns_;
  BasisHeader header_;
};

/// The kept basis, where it is sound and of this take and these options.
std::optional<BasisBytes> kept_basis(const std::filesystem::path& file, const FileState& state,
                                     const BasisOptions& options) {
  std::optional<BasisBytes> memory = read_basis(file);
  if (!memory) {
    return std::nullopt;
  }
  try {
    const BasisHeader& header = *basis_sections(*memory).header;
    const bool fits = header.take == state && header.wanted_coarse_rank == options.coarse_rank &&
                      header.wanted_detail_rank == options.detail_rank;
    return fits ? std::move(memory) : std::nullopt;
  } catch (const Error&) {
    return std::nullopt;  // made anew
  }
}

void check_options(const BasisOptions& options) {
  if (options.coarse_rank < 1 || options.coarse_rank > kMaxRank || options.detail_rank < 0 ||
      options.detail_rank > kMaxRank) {
    throw Error(ErrorKind::Usage,
                fmt::format("a basis has 1 to {0} coarse and 0 to {0} detail directions, not {1} and {2}",
                            kMaxRank, options.coarse_rank, options.detail_rank));
  }
}

/// A frame in the middle of those that the basis was made of.
std::shared_ptr<const mesh::MeshFrame> sample_frame(const std::filesystem::path& take,
                                                    const BasisSections& sections) {
  take::TakeReader reader(take);
  const CapturedFrame& middle = sections.frames[sections.header->frame_count / 2];
  if (middle.index < 0 || middle.index >= reader.frame_count()) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("take '{}' has changed: it has fewer frames", take.string()));
  }
  auto frame = reader.frame(middle.index, take::Pictures::Described);
  if (!mesh::has_mesh(*frame) || frame->subject->hierarchy->id != sections.header->hierarchy_id ||
      frame->subject->hierarchy->control_vertex_count != sections.header->control_vertex_count ||
      frame->subject->hierarchy->finest().vertex_count != sections.header->finest_vertex_count ||
      static_cast<std::int32_t>(frame->subject->expression_names.size()) !=
          sections.header->expression_count) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("take '{}' has changed: its meshes are of another topology", take.string()));
  }
  return frame;
}

}  // namespace

Eigen::MatrixXf narrow_part(const mesh::Hierarchy& hierarchy, const mesh::Vertices& rest_mm,
                            const Eigen::Ref<const Eigen::MatrixXf>& values) {
  const mesh::OneRings& rings = hierarchy.finest().one_rings;
  const auto count = static_cast<std::size_t>(rest_mm.cols());
  // A step takes half of each value and half of the ring's mean: the variance along an axis grows by a
  // quarter of the mean squared edge.
  double squares = 0;
  std::size_t edges = 0;
  for (std::size_t v = 0; v < count; ++v) {
    for (std::int32_t k = rings.offsets[v]; k < rings.offsets[v + 1]; ++k) {
      squares += static_cast<double>((rest_mm.col(rings.neighbours[static_cast<std::size_t>(k)]) -
                                      rest_mm.col(static_cast<Eigen::Index>(v)))
                                         .squaredNorm());
      ++edges;
    }
  }
  const double step_mm2 = 0.25 * squares / static_cast<double>(std::max<std::size_t>(edges, 1));
  const int steps = static_cast<int>(
      std::clamp(std::round(kFoldWidth_mm * kFoldWidth_mm / std::max(step_mm2, 1e-3)), 2.0, 100.0));
  Eigen::MatrixXf broad = values;
  Eigen::MatrixXf next(values.rows(), values.cols());
  for (int step = 0; step < steps; ++step) {
    for (std::size_t v = 0; v < count; ++v) {
      const std::int32_t first = rings.offsets[v];
      const std::int32_t end = rings.offsets[v + 1];
      auto out = next.col(static_cast<Eigen::Index>(v));
      out.setZero();
      for (std::int32_t k = first; k < end; ++k) {
        out += broad.col(rings.neighbours[static_cast<std::size_t>(k)]);
      }
      out *= end > first ? 0.5F / static_cast<float>(end - first) : 0.0F;
      out += (end > first ? 0.5F : 1.0F) * broad.col(static_cast<Eigen::Index>(v));
    }
    broad.swap(next);
  }
  return values - broad;
}

TakeBasis::TakeBasis(std::filesystem::path take, BasisBytes memory, bool was_kept,
                     std::shared_ptr<const mesh::MeshFrame> sample)
    : take_(std::move(take)),
      memory_(std::move(memory)),
      sections_(unsealed_sections(memory_)),
      was_kept_(was_kept),
      sample_(std::move(sample)) {
  std::vector<mesh::Vertices> levels;
  mesh::push_positions(hierarchy(),
                       Eigen::Map<const mesh::Vertices>(sections_.coarse_mean, 3, control_count()), levels);
  rest_mm_ = std::move(levels.back());
}

std::shared_ptr<const TakeBasis> TakeBasis::open(const std::filesystem::path& take,
                                                 const BasisOptions& options, const BasisProgress& progress) {
  check_options(options);
  std::filesystem::path file = options.file;
  if (file.empty()) {
    file = take;
    file.replace_extension(".basis");
  }
  // Opening a take may fold its log in: only then is the file as it stays.
  { const take::TakeReader opened(take); }
  const FileState state = state_of(take);
  std::optional<BasisBytes> memory = kept_basis(file, state, options);
  const bool was_kept = memory.has_value();
  if (!memory) {
    memory = Builder(take, options, progress).build(state);
    if (state_of(take) != state) {
      throw Error(
          ErrorKind::UnreadableInput,
          fmt::format("take '{}' changed while it was read: is it still being recorded?", take.string()));
    }
    try {
      files::OutputFile out(file);
      out.write(std::span<const std::byte>(*memory));
      out.commit();
    } catch (const Error&) {  // a folder that can't be written: it is made anew the next time
    }
  }
  auto sample = sample_frame(take, unsealed_sections(*memory));
  return std::shared_ptr<const TakeBasis>(
      new TakeBasis(take, std::move(*memory), was_kept, std::move(sample)));
}

void TakeBasis::check_unchanged() const {
  if (state_of(take_) != header().take) {
    throw Error(ErrorKind::UnreadableInput,
                fmt::format("take '{}' changed on disk while it was open: open it anew", take_.string()));
  }
}

std::vector<std::pair<std::int32_t, float>> TakeBasis::stencil(std::int32_t finest_vertex) const {
  std::map<std::int32_t, float> row{{finest_vertex, 1.0F}};
  const auto& levels = hierarchy().levels;
  for (auto level = levels.rbegin(); level != levels.rend(); ++level) {
    std::map<std::int32_t, float> coarser;
    for (const auto& [vertex, weight] : row) {
      const mesh::SparseRows& rows = level->from_coarser;
      const auto at = static_cast<std::size_t>(vertex);
      for (std::int32_t k = rows.row_offsets[at]; k < rows.row_offsets[at + 1]; ++k) {
        const auto entry = static_cast<std::size_t>(k);
        coarser[rows.columns[entry]] += weight * rows.weights[entry];
      }
    }
    row = std::move(coarser);
  }
  return {row.begin(), row.end()};
}

}  // namespace facet::animate
