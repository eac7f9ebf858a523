// SPDX-License-Identifier: Apache-2.0
//
// Goal: the table calls the function that was registered for the kind of a request. Method: a
// handler that records its calls.

#include <daemon/serving/request_table.hpp>

#include <gtest/gtest.h>

#include <array>
#include <string>
#include <utility>

namespace agnocast::daemon {
namespace {

struct Handler {
  Result<void> hello(Peer&, const wire::Hello& request) {
    called = "hello " + std::to_string(request.header.request);
    return {};
  }
  Result<void> create(Peer&, const CreateRequest& request) {
    called = "create " + request.topic;
    return fail_with(Errc::limit_reached, "full");
  }
  Result<void> bring(Peer&, const wire::BringWindow&, std::span<UniqueFd> fds) {
    called = "bring " + std::to_string(fds.size());
    return {};
  }
  std::string called;
};

TEST(RequestTable, CallsTheFunctionForTheKind) {
  Handler handler;
  RequestTable table;
  table.add(handler, &Handler::hello);
  table.add(handler, &Handler::create);
  table.add(handler, &Handler::bring);
  EXPECT_FALSE(table.is_complete());
  Peer peer{1, Session(PacketSocket(), PeerIdentity())};

  wire::Hello hello{};
  hello.header.request = 7;
  EXPECT_TRUE(table.serve(peer, hello, {}).has_value());
  EXPECT_EQ(handler.called, "hello 7");

  CreateRequest create;
  create.topic = "/chatter";
  const auto created = table.serve(peer, create, {});
  ASSERT_FALSE(created.has_value());
  EXPECT_EQ(created.error().code, Errc::limit_reached);
  EXPECT_EQ(handler.called, "create /chatter");

  std::array<UniqueFd, 1> fds;
  EXPECT_TRUE(table.serve(peer, wire::BringWindow{}, fds).has_value());
  EXPECT_EQ(handler.called, "bring 1");
}

TEST(RequestTable, KnowsTheIdOfEveryKind) {
  wire::Dump dump{};
  dump.header.request = 3;
  EXPECT_EQ(request_id_of(dump), 3U);
  CreateRequest create;
  create.request = 4;
  EXPECT_EQ(request_id_of(create), 4U);
  LeaveRequest leave;
  leave.reference.header.request = 5;
  EXPECT_EQ(request_id_of(leave), 5U);
  Rejected rejected;
  rejected.request = 6;
  EXPECT_EQ(request_id_of(rejected), 6U);
}

}  // namespace
}  // namespace agnocast::daemon
