// SPDX-License-Identifier: Apache-2.0
//
// Goal: servers and clients that are asked by polling, in C and in C++, get each request and each
// response once, also beside the services and clients of this library; what the other side makes
// impossible is counted, and no error.
// Method: random messages with every kind of member as both halves of a service, between endpoints
// of this process and the real daemon.

#include <ros2/rmw_agnocast_cpp/core/services.hpp>

#include <agnocast/agnocast.hpp>
#include <tests/integration/rmw/messages.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <gmock/gmock.h>
#include <rosidl_runtime_c/string_functions.h>

#include <chrono>
#include <cstdint>
#include <memory>
#include <set>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast::rmw {
namespace {

using namespace std::chrono_literals;
using test::eventually;

/// A service whose halves are these messages.
struct Exchange {
  using Request = Everything;
  using Response = Forest;
};

ServiceSupport service_in_cpp() { return {cpp_support<Everything>(), cpp_support<Forest>()}; }
ServiceSupport service_in_c() { return {c_support<Everything>(), c_support<Forest>()}; }

class RmwServices : public test::SuiteDaemon {
 protected:
  std::unique_ptr<ServiceServer> server(const ServiceSupport& support) {
    return valued(ServiceServer::create(node, service, support, ServicesQoS()));
  }
  std::unique_ptr<ServiceClient> client(const ServiceSupport& support) {
    return valued(ServiceClient::create(node, service, support, ServicesQoS()));
  }
  static void expect_server(const ServiceClient& client) {
    ASSERT_TRUE(eventually([&] { return client.server_count() == 1; }));
  }
  void wait_for(const Readable& readable) {
    ASSERT_TRUE(set.wait({}, {&readable}, std::nullopt).value());
  }

  const NodeName node{"node", "/" + own("space")};
  const std::string service = "/" + own("service");
  WaitPool pool;
  WaitSet set{pool};
};

TEST_F(RmwServices, RequestsAndResponsesArriveInBothLanguages) {
  const auto serving = server(service_in_cpp());
  const auto asking = client(service_in_c());
  expect_server(*asking);
  for (std::uint64_t seed = 1; seed <= 30; ++seed) {
    SCOPED_TRACE(seed);
    const Everything request = random_message<Everything>(seed);
    const Forest response = random_message<Forest>(seed);
    EXPECT_EQ(valued(asking->send(in_c_of(request).get())), static_cast<std::int64_t>(seed));
    wait_for(*serving);
    Everything got;
    RequestId id;
    ASSERT_TRUE(serving->take(&got, id));
    EXPECT_EQ(got, request);
    EXPECT_FALSE(serving->take(&got, id));
    ASSERT_TRUE(serving->send(id, &response));
    wait_for(*asking);
    auto got_in_c = make_in_c<Forest>();
    std::int64_t number = 0;
    ASSERT_TRUE(asking->take(got_in_c.get(), number));
    EXPECT_EQ(number, static_cast<std::int64_t>(seed));
    EXPECT_TRUE(InC<Forest>::are_equal(got_in_c.get(), in_c_of(response).get()));
    EXPECT_FALSE(asking->take(got_in_c.get(), number));
    EXPECT_FALSE(asking->is_ready());
  }
  EXPECT_EQ(asking->dropped_count(), 0u);
  EXPECT_EQ(serving->undelivered_count(), 0u);
}

TEST_F(RmwServices, EachClientGetsItsOwnResponsesInAnyOrder) {
  const auto serving = server(service_in_cpp());
  const auto one = client(service_in_cpp()), two = client(service_in_cpp());
  expect_server(*one);
  expect_server(*two);
  const Everything request;
  for (int i = 0; i < 4; ++i) {
    ASSERT_TRUE(one->send(&request));
    ASSERT_TRUE(two->send(&request));
  }
  std::vector<RequestId> ids;
  ASSERT_TRUE(eventually([&] {
    Everything got;
    RequestId id;
    while (serving->take(&got, id)) ids.push_back(id);
    return ids.size() == 8;
  }));
  const Forest response;
  for (auto id = ids.rbegin(); id != ids.rend(); ++id) ASSERT_TRUE(serving->send(*id, &response));
  for (ServiceClient* const asking : {one.get(), two.get()}) {
    std::multiset<std::int64_t> numbers;
    ASSERT_TRUE(eventually([&] {
      Forest got;
      std::int64_t number = 0;
      while (asking->take(&got, number)) numbers.insert(number);
      return numbers.size() == 4;
    }));
    EXPECT_THAT(numbers, testing::ElementsAre(1, 2, 3, 4));
  }
}

// As a node does that calls its own service at once.
TEST_F(RmwServices, ARequestWaitsForAServerOfItsProcess) {
  const Everything request;
  int late_servers_reached = 0, ready = 0;
  for (int i = 0; i < 20; ++i) {
    std::unique_ptr<ServiceServer> serving;
    std::unique_ptr<ServiceClient> asking;
    if (i % 2 == 0) serving = server(service_in_cpp());
    asking = client(service_in_cpp());
    if (i % 2 == 0) ready += asking->server_count() == 1;
    if (i % 2 != 0) serving = server(service_in_cpp());
    ASSERT_TRUE(asking->send(&request));
    if (asking->dropped_count() != 0) continue;  // load: the match took longer than it waits
    late_servers_reached += i % 2;
    wait_for(*serving);
    Everything got;
    RequestId id;
    ASSERT_TRUE(serving->take(&got, id));
    const Forest response;
    ASSERT_TRUE(serving->send(id, &response));
    EXPECT_EQ(serving->undelivered_count(), 0u);
    wait_for(*asking);
  }
  EXPECT_GE(late_servers_reached, 5) << "of 10 whose server came after the client";
  EXPECT_GE(ready, 5) << "of 10 whose server was there before";
}

TEST_F(RmwServices, OfAnotherDomainAreOthers) {
  const NodeName elsewhere{"node", node.name_space, 57};
  const auto serving =
      valued(ServiceServer::create(elsewhere, service, service_in_cpp(), ServicesQoS()));
  const auto near =
      valued(ServiceClient::create(elsewhere, service, service_in_cpp(), ServicesQoS()));
  const auto far = client(service_in_cpp());
  expect_server(*near);
  EXPECT_EQ(far->server_count(), 0u);
  const Everything request;
  ASSERT_TRUE(far->send(&request));
  EXPECT_EQ(far->dropped_count(), 1u);
  ASSERT_TRUE(near->send(&request));
  wait_for(*serving);
  Everything got;
  RequestId id;
  ASSERT_TRUE(serving->take(&got, id));
  EXPECT_FALSE(serving->take(&got, id));
  const Forest response;
  ASSERT_TRUE(serving->send(id, &response));
  wait_for(*near);
  Forest answer;
  std::int64_t number = 0;
  EXPECT_TRUE(near->take(&answer, number));
}

TEST_F(RmwServices, ServersThatDoNotAnswerFillNoClient) {
  const auto serving = server(service_in_cpp());
  const auto asking = client(service_in_cpp());
  expect_server(*asking);
  const Everything request;
  std::vector<RequestId> ids;
  const auto ask = [&] {
    ASSERT_TRUE(asking->send(&request));
    Everything got;
    ASSERT_TRUE(serving->take(&got, ids.emplace_back()));
  };
  const Forest response;
  Forest got;
  std::int64_t number = 0;
  for (std::size_t i = 0; i < ServiceClient::unanswered_max; ++i) ask();
  // Those that are answered do not count.
  for (int i = 0; i < 10; ++i) {
    ASSERT_TRUE(serving->send(ids.back(), &response));
    wait_for(*asking);
    ASSERT_TRUE(asking->take(&got, number));
    EXPECT_EQ(number, ids.back().sequence);
    ask();
  }
  ask();
  for (const std::size_t answered : {0u, 1u}) ASSERT_TRUE(serving->send(ids[answered], &response));
  wait_for(*asking);
  ASSERT_TRUE(asking->take(&got, number));
  EXPECT_EQ(number, 2) << "the response to the first request comes too late";
  EXPECT_FALSE(asking->take(&got, number));
}

TEST_F(RmwServices, ServicesAndClientsOfThisLibraryTakePart) {
  Node other(own("other"));
  SingleThreadedExecutor executor;
  executor.add_node(other);
  const Everything request = random_message<Everything>(3);
  const Forest response = random_message<Forest>(3);
  {
    const auto serving = other.create_service<Exchange>(
        service, [&](const ipc_shared_ptr<const Everything>& got, ipc_shared_ptr<Forest>& answer) {
          EXPECT_EQ(*got, request);
          *answer = response;
        });
    const auto asking = client(service_in_c());
    expect_server(*asking);
    ASSERT_TRUE(asking->send(in_c_of(request).get()));
    auto got = make_in_c<Forest>();
    std::int64_t number = 0;
    ASSERT_TRUE(eventually([&] {
      executor.spin_some();
      return asking->take(got.get(), number);
    }));
    EXPECT_TRUE(InC<Forest>::are_equal(got.get(), in_c_of(response).get()));
  }
  const auto serving = server(service_in_c());
  const auto asking = other.create_client<Exchange>(service);
  ASSERT_TRUE(eventually([&] { return asking->service_is_ready(); }));
  auto loan = asking->borrow_loaned_request();
  *loan = request;
  auto sent = asking->async_send_request(std::move(loan));
  wait_for(*serving);
  auto got = make_in_c<Everything>();
  RequestId id;
  ASSERT_TRUE(serving->take(got.get(), id));
  EXPECT_TRUE(InC<Everything>::are_equal(got.get(), in_c_of(request).get()));
  ASSERT_TRUE(serving->send(id, in_c_of(response).get()));
  ASSERT_TRUE(eventually([&] {
    executor.spin_some();
    return sent.wait_for(0s) == std::future_status::ready;
  }));
  EXPECT_EQ(*sent.get(), response);
}

TEST_F(RmwServices, WhatThePeerMakesImpossibleIsNoError) {
  const auto asking = client(service_in_cpp());
  EXPECT_EQ(asking->server_count(), 0u);
  const Everything request;
  EXPECT_EQ(valued(asking->send(&request)), 1);
  EXPECT_EQ(asking->dropped_count(), 1u);
  const auto serving = server(service_in_cpp());
  const Forest response;
  RequestId id;
  {
    const auto leaving = client(service_in_cpp());
    expect_server(*leaving);
    ASSERT_TRUE(leaving->send(&request));
    wait_for(*serving);
    Everything got;
    ASSERT_TRUE(serving->take(&got, id));
  }
  ASSERT_TRUE(eventually([&] {
    EXPECT_TRUE(serving->send(id, &response));
    return serving->undelivered_count() != 0;
  }));
  EXPECT_TRUE(serving->send({12345, 1}, &response)) << "a client that there never was";
}

TEST_F(RmwServices, ARequestThatIsTooLongForItsTypeIsRefused) {
  const auto serving = server(service_in_cpp());
  const auto asking = client(service_in_c());
  expect_server(*asking);
  auto request = make_in_c<Everything>();
  ASSERT_TRUE(
      rosidl_runtime_c__String__assign(&request->bounded_text, std::string(41, 'x').c_str()));
  const auto refused = asking->send(request.get());
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().code, Errc::type_refused);
}

}  // namespace
}  // namespace agnocast::rmw
