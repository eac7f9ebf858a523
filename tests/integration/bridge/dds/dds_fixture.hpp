// SPDX-License-Identifier: Apache-2.0
//
// Helpers shared by the tests of the bridge's DDS entities.
#pragma once

#include <tests/integration/bridge/dds/dds_domain.hpp>
#include <tests/support/memory/descriptors.hpp>

#include <dirent.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <fstream>
#include <stdexcept>
#include <thread>

namespace agnocast::test {

using bridge::Remote;
using bridge::RemoteChange;
using bridge::WriteOutcome;
using namespace std::chrono_literals;

inline constexpr auto raw_type = "agnocast_test::msg::dds_::Raw_";
inline constexpr int answer_s = 90;

inline std::unique_ptr<DdsWriter> writer(DdsParticipant& of, const std::string& topic,
                                         const std::string& qos = "reliable 10",
                                         const std::string& type = raw_type) {
  return std::move(of.create_writer(topic, type, qos_of(qos)).value());
}
inline std::unique_ptr<DdsReader> reader(DdsParticipant& of, const std::string& topic,
                                         const std::string& qos = "reliable 10",
                                         const std::string& type = raw_type,
                                         bridge::RawDecoder decoder = keep_bytes) {
  return std::move(of.create_reader(topic, type, qos_of(qos), std::move(decoder)).value());
}

}  // namespace agnocast::test
