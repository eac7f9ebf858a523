// SPDX-License-Identifier: Apache-2.0
//
// Replaces dds_road.cpp if Cyclone DDS was not found at build time.

#include <examples/demo/dds_road.hpp>

namespace demo {

namespace {
constexpr const char* sentence =
    "built without Cyclone DDS (Debian: cyclonedds-dev, cyclonedds-tools)";
}

std::unique_ptr<DdsWriter> DdsWriter::make(const std::string&, std::string& why) {
  why = sentence;
  return nullptr;
}

std::unique_ptr<DdsReader> DdsReader::make(const std::string&, Callback, std::string& why) {
  why = sentence;
  return nullptr;
}

}  // namespace demo
