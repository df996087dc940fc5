# Imported targets OpenCV::core, ::imgproc, ::imgcodecs and ::dnn. Debian ships OpenCV's CMake package only in
# libopencv-dev, which pulls in every module with its GUI; the modules' own packages hold headers and libraries alone.
find_path(FACET_OPENCV_INCLUDE_DIR opencv2/core.hpp PATH_SUFFIXES opencv4 REQUIRED)
foreach(module core imgproc imgcodecs dnn)
  if(NOT TARGET OpenCV::${module})
    find_library(FACET_OPENCV_${module}_LIBRARY opencv_${module} REQUIRED)
    add_library(OpenCV::${module} UNKNOWN IMPORTED GLOBAL)
    set_target_properties(OpenCV::${module} PROPERTIES
      IMPORTED_LOCATION "${FACET_OPENCV_${module}_LIBRARY}"
      INTERFACE_INCLUDE_DIRECTORIES "${FACET_OPENCV_INCLUDE_DIR}")
    if(NOT module STREQUAL "core")
      set_property(TARGET OpenCV::${module} PROPERTY INTERFACE_LINK_LIBRARIES OpenCV::core)
    endif()
  endif()
endforeach()
