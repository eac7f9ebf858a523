// SPDX-License-Identifier: Apache-2.0
//
// The other road of the comparison: the same message through Eclipse Cyclone DDS, by its C
// interface and a type made by idlc. dds_absent.cpp stands in where Cyclone DDS is not installed.
#pragma once

#include <examples/demo/content.hpp>

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

namespace demo {

class DdsWriter {
 public:
  /// Null when there is no Cyclone DDS or it does not start; `why` says why.
  static std::unique_ptr<DdsWriter> make(const std::string& topic, std::string& why);
  virtual ~DdsWriter() = default;
  virtual bool is_matched() = 0;
  /// Fills the writer's sample with the content of `cloud`. Not part of what is measured.
  virtual void fill(const Cloud& cloud) = 0;
  /// dds_write: serializes and sends.
  virtual bool write() = 0;
};

class DdsReader {
 public:
  /// Called in a thread of Cyclone DDS, after dds_take has given the whole sample.
  using Callback =
      std::function<void(std::uint64_t number, bool intact, std::uint64_t received_ns)>;
  static std::unique_ptr<DdsReader> make(const std::string& topic, Callback callback,
                                         std::string& why);
  virtual ~DdsReader() = default;
};

}  // namespace demo
