#include "landmark/landmark_layout.hpp"

namespace facet::landmark {
namespace {

// Indices of MediaPipe's face mesh topology (the FACEMESH_* connection sets of its documentation).
constexpr std::array kContour = {10,  338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288,
                                 397, 365, 379, 378, 400, 377, 152, 148, 176, 149, 150, 136,
                                 172, 58,  132, 93,  234, 127, 162, 21,  54,  103, 67,  109};
constexpr std::array kBrows = {276, 283, 282, 295, 285, 300, 293, 334, 296, 336,
                               46,  53,  52,  65,  55,  70,  63,  105, 66,  107};
constexpr std::array kEyes = {263, 249, 390, 373, 374, 380, 381, 382, 362, 466, 388, 387, 386, 385, 384, 398,
                              33,  7,   163, 144, 145, 153, 154, 155, 133, 246, 161, 160, 159, 158, 157, 173};
constexpr std::array kLips = {61,  146, 91,  181, 84,  17,  314, 405, 321, 375, 291, 185, 40,  39,
                              37,  0,   267, 269, 270, 409, 78,  95,  88,  178, 87,  14,  317, 402,
                              318, 324, 308, 191, 80,  81,  82,  13,  312, 311, 310, 415};
constexpr std::array kNose = {168, 6,   197, 195, 5,   4,   1,   19, 94,  2,   98, 97,
                              326, 327, 294, 278, 344, 440, 275, 45, 220, 115, 48, 64};

// The same documentation's refined parts, ring by ring.
constexpr std::array kLipRings = {
    61, 146, 91, 181, 84, 17, 314, 405, 321, 375, 291, 185, 40, 39, 37, 0,  267, 269, 270, 409,
    78, 95,  88, 178, 87, 14, 317, 402, 318, 324, 308, 191, 80, 81, 82, 13, 312, 311, 310, 415,
    76, 77,  90, 180, 85, 16, 315, 404, 320, 307, 306, 184, 74, 73, 72, 11, 302, 303, 304, 408,
    62, 96,  89, 179, 86, 15, 316, 403, 319, 325, 292, 183, 42, 41, 38, 12, 268, 271, 272, 407};
constexpr std::array kRightEyeRings = {
    33,  7,   163, 144, 145, 153, 154, 155, 133, 246, 161, 160, 159, 158, 157, 173, 130, 25,
    110, 24,  23,  22,  26,  112, 243, 247, 30,  29,  27,  28,  56,  190, 226, 31,  228, 229,
    230, 231, 232, 233, 244, 113, 225, 224, 223, 222, 221, 189, 35,  124, 46,  53,  52,  65,
    143, 111, 117, 118, 119, 120, 121, 128, 245, 156, 70,  63,  105, 66,  107, 55,  193};
constexpr std::array kLeftEyeRings = {
    263, 249, 390, 373, 374, 380, 381, 382, 362, 466, 388, 387, 386, 385, 384, 398, 359, 255,
    339, 254, 253, 252, 256, 341, 463, 467, 260, 259, 257, 258, 286, 414, 446, 261, 448, 449,
    450, 451, 452, 453, 464, 342, 445, 444, 443, 442, 441, 413, 265, 353, 276, 283, 282, 295,
    372, 340, 346, 347, 348, 349, 350, 357, 465, 383, 300, 293, 334, 296, 336, 285, 417};

template <std::size_t count>
void assign(std::array<LandmarkGroup, landmark_count>& groups, const std::array<int, count>& members,
            LandmarkGroup group) {
  for (const int index : members) {
    groups[static_cast<std::size_t>(index)] = group;
  }
}

}  // namespace

const std::array<LandmarkGroup, landmark_count>& landmark_groups() {
  static const std::array<LandmarkGroup, landmark_count> groups = [] {
    std::array<LandmarkGroup, landmark_count> table{};
    assign(table, kContour, LandmarkGroup::Contour);
    assign(table, kBrows, LandmarkGroup::Brow);
    assign(table, kEyes, LandmarkGroup::Eye);
    assign(table, kLips, LandmarkGroup::Lips);
    assign(table, kNose, LandmarkGroup::Nose);
    return table;
  }();
  return groups;
}

std::span<const int> contour_landmarks() {
  return kContour;
}

std::span<const int> lip_landmarks() {
  return kLipRings;
}
std::span<const int> right_eye_landmarks() {
  return kRightEyeRings;
}
std::span<const int> left_eye_landmarks() {
  return kLeftEyeRings;
}

}  // namespace facet::landmark
