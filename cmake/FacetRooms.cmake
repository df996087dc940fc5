# One library target per room. A room's headers are reached as "<room>/<header>.hpp" through a folder that
# exposes that room alone, so an include of a room that the target does not link does not compile.

add_library(facet_options INTERFACE)
target_compile_options(facet_options INTERFACE -Wall -Wextra -Wshadow -Wconversion -Wnon-virtual-dtor -Werror
                       -fno-math-errno -fno-trapping-math)
if(CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64")
  # AVX2 and FMA: every x86-64 machine of the last ten years. facetd and facet check it at start.
  set(FACET_MARCH "x86-64-v3" CACHE STRING "Value of -march")
  if(FACET_MARCH)
    target_compile_options(facet_options INTERFACE "-march=${FACET_MARCH}")
  endif()
endif()
if(FACET_SANITIZE)
  target_compile_options(facet_options INTERFACE "-fsanitize=${FACET_SANITIZE}" -fno-omit-frame-pointer
                         -fno-sanitize-recover=all -g1)
  target_link_options(facet_options INTERFACE "-fsanitize=${FACET_SANITIZE}")
  target_compile_definitions(facet_options INTERFACE FACET_SANITIZED=1)
  if(FACET_SANITIZE MATCHES "address" AND CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
    # GCC 12 reports false maybe-uninitialized and similar warnings under the sanitizers.
    target_compile_options(facet_options INTERFACE -Wno-maybe-uninitialized -Wno-stringop-overflow -Wno-array-bounds)
  endif()
endif()

# facet_room(<name> SOURCES <files> [ROOMS <rooms it includes in its headers>] [LIBS <external, public>]
#            [PRIVATE_ROOMS <rooms>] [PRIVATE_LIBS <external>])
function(facet_room name)
  cmake_parse_arguments(ARG "" "" "SOURCES;ROOMS;LIBS;PRIVATE_ROOMS;PRIVATE_LIBS" ${ARGN})
  set(door "${CMAKE_BINARY_DIR}/rooms/${name}")
  file(MAKE_DIRECTORY "${door}")
  file(CREATE_LINK "${CMAKE_CURRENT_SOURCE_DIR}" "${door}/${name}" SYMBOLIC)
  list(TRANSFORM ARG_ROOMS PREPEND "facet_")
  list(TRANSFORM ARG_PRIVATE_ROOMS PREPEND "facet_")
  if(ARG_SOURCES)
    add_library(facet_${name} STATIC ${ARG_SOURCES})
    target_include_directories(facet_${name} PUBLIC "${door}")
    target_link_libraries(facet_${name} PUBLIC ${ARG_ROOMS} ${ARG_LIBS}
                          PRIVATE facet_options ${ARG_PRIVATE_ROOMS} ${ARG_PRIVATE_LIBS})
  else()
    add_library(facet_${name} INTERFACE)
    target_include_directories(facet_${name} INTERFACE "${door}")
    target_link_libraries(facet_${name} INTERFACE ${ARG_ROOMS} ${ARG_LIBS})
  endif()
endfunction()

# facet_test(<room> SOURCES <files> [ROOMS <rooms>] [LIBS <external>]): one gtest program test_<room>, each case a ctest.
# ctest runs each with the Vulkan validation layers on, where they are installed.
function(facet_test name)
  cmake_parse_arguments(ARG "" "" "SOURCES;ROOMS;LIBS" ${ARGN})
  list(TRANSFORM ARG_ROOMS PREPEND "facet_")
  add_executable(test_${name} ${ARG_SOURCES})
  target_link_libraries(test_${name} PRIVATE facet_options facet_test_support ${ARG_ROOMS} ${ARG_LIBS} GTest::gtest GTest::gmock GTest::gtest_main)
  gtest_discover_tests(test_${name} TEST_PREFIX "${name}." DISCOVERY_MODE PRE_TEST WORKING_DIRECTORY "${CMAKE_SOURCE_DIR}"
                       DISCOVERY_TIMEOUT 120 PROPERTIES TIMEOUT 900 ENVIRONMENT FACET_VULKAN_VALIDATION=1)
endfunction()

add_custom_target(fuzzers)

# facet_fuzzer(<name> SOURCES <files> ROOMS <rooms>): a libFuzzer program fuzz_<name>; its corpus is tests/fuzz/corpus/<name>.
function(facet_fuzzer name)
  if(NOT FACET_FUZZ)
    return()
  endif()
  cmake_parse_arguments(ARG "" "" "SOURCES;ROOMS;LIBS" ${ARGN})
  list(TRANSFORM ARG_ROOMS PREPEND "facet_")
  add_executable(fuzz_${name} ${ARG_SOURCES})
  set_target_properties(fuzz_${name} PROPERTIES RUNTIME_OUTPUT_DIRECTORY "${CMAKE_BINARY_DIR}/fuzzers")
  add_dependencies(fuzzers fuzz_${name})
  target_link_libraries(fuzz_${name} PRIVATE facet_options ${ARG_ROOMS} ${ARG_LIBS})
  target_link_options(fuzz_${name} PRIVATE -fsanitize=fuzzer)
endfunction()

# facet_program(<name> SOURCES <files> [ROOMS ...] [LIBS ...])
function(facet_program name)
  cmake_parse_arguments(ARG "" "" "SOURCES;ROOMS;LIBS" ${ARGN})
  list(TRANSFORM ARG_ROOMS PREPEND "facet_")
  add_executable(${name} ${ARG_SOURCES})
  target_link_libraries(${name} PRIVATE facet_options ${ARG_ROOMS} ${ARG_LIBS})
endfunction()
