// SPDX-License-Identifier: Apache-2.0
//
// Fixture for tests of the bridge as a program: agnocastd, agnocast-bridge, this process with its
// agnocast endpoints, and Other, a DDS participant like one of another host; all in a domain of
// the test's own.
#pragma once

#include <agnocast/agnocast.hpp>
#include <agnocast/generic.hpp>
#include <base/sockets/unix_address.hpp>
#include <bridge/cdr/cdr.hpp>
#include <bridge/dds/names.hpp>
#include <bridge/dds/participant.hpp>
#include <tests/integration/bridge/dds/dds_domain.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/steered_process.hpp>

#include <rosidl_runtime_cpp/traits.hpp>

#include <gtest/gtest.h>

#include <sys/socket.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <fstream>
#include <functional>
#include <iostream>
#include <memory>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

namespace agnocast::test {

using bridge::CdrType;
using bridge::Guid;
using bridge::Remote;

template <class T>
std::string dds_type_name() {
  return bridge::dds_type_of(rosidl_generator_traits::name<T>()).value();
}
template <class T>
const CdrType& cdr_type() {
  static const CdrType type =
      CdrType::of(*static_cast<const MessageMembers*>(MessageTraits<T>::table())).value();
  return type;
}

/// Reads and writes CDR.
class Other {
 public:
  explicit Other(std::uint32_t domain)
      : participant_(DdsParticipant::create({.domain = domain}).value()) {}

  template <class T>
  DdsReader& reads(const std::string& topic, const DdsQos& qos) {
    return reads(topic, dds_type_name<T>(), qos, [](bridge::RawPieces pieces) {
      auto message = std::make_shared<T>();
      return bridge::read_cdr(cdr_type<T>(), pieces, message.get()) ? std::shared_ptr<void>(message)
                                                                    : nullptr;
    });
  }
  DdsReader& reads(const std::string& topic, const std::string& type, const DdsQos& qos,
                   bridge::RawDecoder decoder = keep_bytes) {
    readers_.push_back(participant_->create_reader(topic, type, qos, std::move(decoder)).value());
    return *readers_.back();
  }
  DdsWriter& writes(const std::string& topic, const std::string& type, const DdsQos& qos) {
    writers_.push_back(participant_->create_writer(topic, type, qos).value());
    return *writers_.back();
  }
  template <class T>
  static bool write(DdsWriter& writer, const T& message, std::int64_t time_ns = 1) {
    const CdrType& type = cdr_type<T>();
    const auto written = writer.write(
        bridge::cdr_bytes(type, &message),
        [&](std::span<std::byte> room) {
          return bridge::write_cdr(type, &message, room).value_or(0);
        },
        time_ns);
    return written && *written == bridge::WriteOutcome::sent;
  }
  /// Returns the next message, waiting up to `wait`.
  template <class T>
  std::shared_ptr<T> take(DdsReader& reader, std::chrono::milliseconds wait = patience) {
    const auto end = std::chrono::steady_clock::now() + wait;
    while (std::chrono::steady_clock::now() < end) {
      if (auto sample = reader.take()) {
        last_ = *sample;
        if (sample->state == DdsSample::State::valid)
          return std::static_pointer_cast<T>(sample->object);
        continue;
      }
      look(std::chrono::milliseconds(10));
    }
    return nullptr;
  }
  bool eventually(const std::function<bool()>& condition) {
    return until(*participant_, condition);
  }
  void look(std::chrono::milliseconds wait) {
    ASSERT_TRUE(participant_->wait(wait));
    participant_->discovered();
  }
  std::size_t remote_count(const std::string& topic, Remote::Kind kind) const {
    std::size_t count = 0;
    for (const auto& [guid, remote] : participant_->remotes())
      if (remote.topic == topic && remote.kind == kind) ++count;
    return count;
  }
  DdsParticipant& participant() { return *participant_; }
  const DdsSample& last() const { return last_; }
  /// Deletes all of its endpoints.
  void forget() {
    readers_.clear();
    writers_.clear();
  }

 private:
  std::unique_ptr<DdsParticipant> participant_;
  std::vector<std::unique_ptr<DdsReader>> readers_;
  std::vector<std::unique_ptr<DdsWriter>> writers_;
  DdsSample last_;
};

/// One daemon and one domain for all tests of a program, since the library has one of each per
/// process; a bridge for each test.
class BridgeTest : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    if (daemon) return;
    domain = std::make_unique<Domain>();
    ::setenv("ROS_DOMAIN_ID", std::to_string(domain->id()).c_str(), 1);
    // A test stops its worker, for as long as a loaded machine takes.
    daemon = std::make_unique<DaemonProcess>(
        DaemonOptions{.more_daemon_config = "watchdog_seconds = \"off\"\n"});
    ::setenv("AGNOCAST_SOCKET", daemon->socket_path().c_str(), 1);
  }
  void SetUp() override { start_bridge(); }
  void TearDown() override {
    if (HasFailure()) std::cerr << "log of agnocast-bridge:\n" << bridge_log();
    ::unlink(log_path_.c_str());
  }

  void start_bridge(const std::vector<std::string>& arguments = {},
                    const std::vector<std::string>& environment = {}) {
    bridge_ = make_bridge(arguments, environment);
  }
  /// Starts one more bridge; all write to one log.
  std::unique_ptr<SteeredProcess> make_bridge(const std::vector<std::string>& arguments = {},
                                              const std::vector<std::string>& environment = {}) {
    EXPECT_TRUE(std::getenv("AMENT_PREFIX_PATH"))
        << "the bridge finds message types by AMENT_PREFIX_PATH: source install/setup.bash first";
    std::vector<std::string> words = {"/bin/sh", "-c", "log=$1; shift; exec env \"$@\" 2>>\"$log\"",
                                      "sh", log_path_};
    words.insert(words.end(), environment.begin(), environment.end());
    words.push_back(AGNOCAST_BRIDGE);
    words.insert(words.end(), arguments.begin(), arguments.end());
    return std::make_unique<SteeredProcess>(words, std::vector<std::string>{});
  }
  std::string bridge_log() const {
    std::ostringstream text;
    text << std::ifstream(log_path_).rdbuf();
    return text.str();
  }
  /// Returns how often the log contains this text.
  std::size_t said(const std::string& what) const {
    const std::string log = bridge_log();
    std::size_t count = 0;
    for (std::size_t at = log.find(what); at != log.npos; at = log.find(what, at + 1)) ++count;
    return count;
  }
  /// Returns the status of the bridge with this --status-socket; empty if it does not answer.
  static std::string status_at(const std::string& path) {
    const UniqueFd fd(::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0));
    const auto address = unix_address(path);
    if (!address || ::connect(fd.get(), address->get(), UnixAddress::size()) != 0) return {};
    std::string text;
    char letters[4096];
    for (ssize_t count = 0; (count = ::read(fd.get(), letters, sizeof letters)) > 0;)
      text.append(letters, static_cast<std::size_t>(count));
    return text;
  }
  /// Returns whether both sides have matched: later messages arrive.
  static bool is_out(const DdsReader& reader, const PublisherBase& publisher,
                     std::size_t subscriptions = 1) {
    return reader.matched() == 1 && publisher.get_linked_subscription_count() == subscriptions;
  }
  /// Each test has topics of its own, so that none sees another's endpoints.
  std::string topic() const {
    return std::string("/") + testing::UnitTest::GetInstance()->current_test_info()->name();
  }
  std::string dds_topic() const { return "rt" + topic(); }

  static inline std::unique_ptr<Domain> domain;
  static inline std::unique_ptr<DaemonProcess> daemon;
  const std::string log_path_ =
      testing::TempDir() + "bridge_test-" + std::to_string(::getpid()) + ".log";
  Other other_{domain->id()};
  std::unique_ptr<SteeredProcess> bridge_;
};

}  // namespace agnocast::test
