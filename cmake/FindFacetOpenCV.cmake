# OpenCV's parts as imported targets FacetOpenCV::<part>, found one by one: Debian's OpenCVConfig.cmake comes only with
# libopencv-dev, which pulls in the whole of OpenCV (VTK, Qt, GDAL ...) where libopencv-imgproc-dev and its like are enough.
#   find_package(FacetOpenCV REQUIRED COMPONENTS core imgproc)
find_path(FacetOpenCV_INCLUDE_DIR opencv2/core.hpp PATH_SUFFIXES opencv4)
foreach(part ${FacetOpenCV_FIND_COMPONENTS})
  find_library(FacetOpenCV_${part}_LIBRARY opencv_${part})
  find_path(FacetOpenCV_${part}_HEADER opencv2/${part}.hpp HINTS "${FacetOpenCV_INCLUDE_DIR}")
  if(FacetOpenCV_INCLUDE_DIR AND FacetOpenCV_${part}_LIBRARY AND FacetOpenCV_${part}_HEADER)
    set(FacetOpenCV_${part}_FOUND TRUE)
    if(NOT TARGET FacetOpenCV::${part})
      add_library(FacetOpenCV::${part} UNKNOWN IMPORTED)
      set_target_properties(FacetOpenCV::${part} PROPERTIES
        IMPORTED_LOCATION "${FacetOpenCV_${part}_LIBRARY}"
        INTERFACE_INCLUDE_DIRECTORIES "${FacetOpenCV_INCLUDE_DIR}"
        INTERFACE_SYSTEM_INCLUDE_DIRECTORIES "${FacetOpenCV_INCLUDE_DIR}")
    endif()
  endif()
  mark_as_advanced(FacetOpenCV_${part}_LIBRARY FacetOpenCV_${part}_HEADER)
endforeach()
include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(FacetOpenCV REQUIRED_VARS FacetOpenCV_INCLUDE_DIR HANDLE_COMPONENTS
  REASON_FAILURE_MESSAGE "install libopencv-core-dev and libopencv-imgproc-dev")
