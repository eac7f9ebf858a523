// SPDX-License-Identifier: Apache-2.0
//
// Goal: services of types that rosidl generated, typed and found at run time, match each other;
// strings and sequences in their requests and responses arrive whole.
// Method: the public interface with the real daemon, in one process; typed and generic sides check
// each other.

#include <agnocast/agnocast.hpp>
#include <agnocast/generic_service.hpp>
#include <tests/support/processes/daemon_process.hpp>
#include <tests/support/processes/spun.hpp>
#include <tests/support/processes/suite_daemon.hpp>

#include <example_interfaces/srv/add_two_ints.hpp>
#include <std_srvs/srv/empty.hpp>
#include <test_msgs/srv/arrays.hpp>

#include <gmock/gmock.h>

#include <array>
#include <atomic>
#include <chrono>
#include <cstdlib>
#include <future>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using namespace std::chrono_literals;
using example_interfaces::srv::AddTwoInts;
using test::eventually;
using test::Spun;
using Arrays = test_msgs::srv::Arrays;

constexpr auto patience = 5min;

class GenericServices : public test::SuiteDaemon {
 protected:
  static void SetUpTestSuite() {
    test::DaemonOptions options;
    options.config = "[heap]\nwindow_bytes = \"64MiB\"\n";
    start(options);
  }
};

void add(const ipc_shared_ptr<const AddTwoInts::Request>& request,
         ipc_shared_ptr<AddTwoInts::Response>& response) {
  response->sum = request->a + request->b;
}

template <class FutureT>
bool is_ready_soon(const FutureT& future) {
  return future.wait_for(patience) == std::future_status::ready;
}

template <class T>
T& as(const GenericLoan& loan) {
  return *static_cast<T*>(loan.get());
}
template <class T>
const T& as(const GenericMessage& message) {
  return *static_cast<const T*>(message.get());
}

TEST_F(GenericServices, OfRosTypesAreTyped) {
  Spun<Node> node("node");
  auto service = node.create_service<AddTwoInts>("add", add);
  auto client = node.create_client<AddTwoInts>("add");
  ASSERT_TRUE(client->wait_for_service(patience));
  auto request = client->borrow_loaned_request();
  request->a = 2;
  request->b = 40;
  auto sent = client->async_send_request(std::move(request));
  ASSERT_TRUE(is_ready_soon(sent));
  EXPECT_EQ(sent.get()->sum, 42);
}

TEST_F(GenericServices, AnswerTypedClients) {
  Spun<Node> node("node");
  auto service = create_generic_service(node, "add_generic", "example_interfaces/srv/AddTwoInts",
                                        [](const GenericMessage& request, GenericLoan& response) {
                                          const auto& two = as<AddTwoInts::Request>(request);
                                          as<AddTwoInts::Response>(response).sum = two.a + two.b;
                                        });
  auto client = node.create_client<AddTwoInts>("add_generic");
  ASSERT_TRUE(client->wait_for_service(patience));
  auto request = client->borrow_loaned_request();
  request->a = 3;
  request->b = 4;
  auto sent = client->async_send_request(std::move(request));
  ASSERT_TRUE(is_ready_soon(sent));
  EXPECT_EQ(sent.get()->sum, 7);
}

TEST_F(GenericServices, AnswerGenericClientsLater) {
  Spun<Node> node("node");
  std::mutex mutex;
  std::vector<GenericServiceRequest> kept;
  const IntrospectedServiceType type = find_service_type("example_interfaces/AddTwoInts");
  auto service =
      create_generic_service(node, "add_later", type, [&](GenericServiceRequest request) {
        const std::lock_guard lock(mutex);
        kept.push_back(std::move(request));
      });
  auto client = create_generic_client(node, "add_later", type);
  ASSERT_TRUE(client->wait_for_service(patience));
  std::promise<std::int64_t> called;
  GenericLoan request = client->borrow_loaned_request();
  ASSERT_STREQ(request.members()->message_name_, "AddTwoInts_Request");
  as<AddTwoInts::Request>(request).a = 5;
  const auto sent = client->async_send_request(
      std::move(request), [&](const GenericClient::SharedFuture& future) {
        called.set_value(as<AddTwoInts::Response>(future.get()).sum);
      });
  EXPECT_FALSE(request);
  ASSERT_TRUE(eventually([&] {
    const std::lock_guard lock(mutex);
    return kept.size() == 1;
  }));
  EXPECT_EQ(kept[0].id().sequence, sent.request_id);
  GenericLoan response = service->borrow_loaned_response();
  as<AddTwoInts::Response>(response).sum = as<AddTwoInts::Request>(kept[0].message()).a + 1;
  EXPECT_EQ(service->send_response(kept[0], std::move(response)).code, Errc::ok);
  EXPECT_EQ(service->send_response(kept[0], service->borrow_loaned_response()).code,
            Errc::already_answered);
  auto sum = called.get_future();
  ASSERT_TRUE(is_ready_soon(sum));
  EXPECT_EQ(sum.get(), 6);
}

TEST_F(GenericServices, CarryStringsAndSequencesWhole) {
  Spun<Node> node("node");
  const IntrospectedServiceType type = find_service_type("test_msgs/srv/Arrays");
  Arrays::Request asked;
  for (std::size_t i = 0; i < asked.string_values.size(); ++i)
    asked.string_values[i] = std::string(100 * (i + 1), static_cast<char>('a' + i));
  // The generic side copies the typed side's values by the table, and back.
  auto service = create_generic_service(
      node, "arrays", type, [&](const GenericMessage& request, GenericLoan& response) {
        as<Arrays::Response>(response).string_values = as<Arrays::Request>(request).string_values;
      });
  auto client = create_generic_client(node, "arrays", type);
  ASSERT_TRUE(client->wait_for_service(patience));
  GenericLoan request = client->borrow_loaned_request();
  type.request.assign(&asked, request.get());
  auto sent = client->async_send_request(std::move(request));
  ASSERT_TRUE(is_ready_soon(sent));
  const GenericMessage response = sent.get();
  EXPECT_EQ(as<Arrays::Response>(response).string_values, asked.string_values);
}

TEST_F(GenericServices, AdoptForeignMemory) {
  Spun<Node> node("node");
  auto service =
      node.create_service<Arrays>("adopts", [](const ipc_shared_ptr<const Arrays::Request>& request,
                                               ipc_shared_ptr<Arrays::Response>& response) {
        response->string_values = request->string_values;
      });
  for (const bool is_generic : {false, true}) {
    std::array<std::string, 3> foreign;
    foreign.fill(std::string(500, 'f'));
    if (is_generic) {
      auto client = create_generic_client(node, "adopts", "test_msgs/srv/Arrays");
      ASSERT_TRUE(client->wait_for_service(patience));
      GenericLoan request = client->borrow_loaned_request();
      const std::array<std::string, 3> expected = foreign;
      as<Arrays::Request>(request).string_values = std::move(foreign);
      auto sent = client->async_send_request(std::move(request));
      ASSERT_TRUE(is_ready_soon(sent));
      EXPECT_EQ(as<Arrays::Response>(sent.get()).string_values, expected);
    } else {
      auto client = node.create_client<Arrays>("adopts");
      ASSERT_TRUE(client->wait_for_service(patience));
      auto request = client->borrow_loaned_request();
      const std::array<std::string, 3> expected = foreign;
      request->string_values = std::move(foreign);
      auto sent = client->async_send_request(std::move(request));
      ASSERT_TRUE(is_ready_soon(sent));
      EXPECT_EQ(sent.get()->string_values, expected);
    }
  }
}

// The service interprets a request by its own type, so one of another type must not pass. A new
// client, or service, is usually made at the address of the previous one.
TEST_F(GenericServices, ARequestThatOutlivesItsClientIsRefusedByOtherTypes) {
  Spun<Node> node("node");
  std::atomic<int> asked{0};
  auto service = create_generic_service(node, "stale_requests", "test_msgs/srv/Arrays",
                                        [&](const GenericMessage&, GenericLoan&) { ++asked; });
  std::vector<GenericLoan> stale;
  for (int round = 0; round < 20; ++round) {
    {
      auto client = create_generic_client(node, "others", "example_interfaces/srv/AddTwoInts");
      stale.push_back(client->borrow_loaned_request());
      EXPECT_TRUE(client->pause(stale.back().handle()));
    }
    auto client = create_generic_client(node, "stale_requests", "test_msgs/srv/Arrays");
    ASSERT_TRUE(client->wait_for_service(patience));
    for (GenericLoan& loan : stale) {
      const auto sent = client->try_async_send_request(std::move(loan));
      ASSERT_FALSE(sent) << round;
      ASSERT_EQ(sent.error().code, Errc::loan_invalid);
      ASSERT_FALSE(client->pause(loan.handle()));
      ASSERT_TRUE(loan) << "the caller still has it";
    }
    auto sent = client->async_send_request(client->borrow_loaned_request());
    ASSERT_TRUE(is_ready_soon(sent));
    EXPECT_EQ(asked, round + 1);
  }
}

TEST_F(GenericServices, AResponseThatOutlivesItsServiceIsRefusedByOtherTypes) {
  Spun<Node> node("node");
  std::vector<GenericLoan> stale;
  auto client = create_generic_client(node, "stale_responses", "test_msgs/srv/Arrays");
  for (int round = 0; round < 20; ++round) {
    const auto ignore = [](GenericServiceRequest) {};
    {
      auto service =
          create_generic_service(node, "others", "example_interfaces/srv/AddTwoInts", ignore);
      stale.push_back(service->borrow_loaned_response());
      EXPECT_TRUE(service->pause(stale.back()));
    }
    std::promise<GenericServiceRequest> asked;
    auto service =
        create_generic_service(node, "stale_responses", "test_msgs/srv/Arrays",
                               [&](GenericServiceRequest request) { asked.set_value(request); });
    ASSERT_TRUE(client->wait_for_service(patience));
    auto sent = client->async_send_request(client->borrow_loaned_request());
    auto arrived = asked.get_future();
    ASSERT_TRUE(is_ready_soon(arrived));
    const GenericServiceRequest request = arrived.get();
    for (GenericLoan& loan : stale) {
      ASSERT_EQ(service->send_response(request, std::move(loan)).code, Errc::loan_invalid) << round;
      ASSERT_FALSE(service->pause(loan));
      ASSERT_TRUE(loan) << "the caller still has it";
    }
    EXPECT_EQ(service->send_response(request, service->borrow_loaned_response()).code, Errc::ok)
        << "the request can still be answered";
    ASSERT_TRUE(is_ready_soon(sent));
    EXPECT_TRUE(sent.get());
  }
}

TEST_F(GenericServices, OfEmptyMessagesAnswer) {
  Spun<Node> node("node");
  auto service = node.create_service<std_srvs::srv::Empty>(
      "empty", [](const ipc_shared_ptr<const std_srvs::srv::Empty::Request>&,
                  ipc_shared_ptr<std_srvs::srv::Empty::Response>&) {});
  auto client = create_generic_client(node, "empty", "std_srvs/srv/Empty");
  ASSERT_TRUE(client->wait_for_service(patience));
  auto sent = client->async_send_request(client->borrow_loaned_request());
  ASSERT_TRUE(is_ready_soon(sent));
  EXPECT_TRUE(sent.get());
}

TEST_F(GenericServices, OfUnknownTypesAreRefused) {
  Node node("node");
  const auto code = [&](const std::string& type) {
    const auto made = try_create_generic_client(node, "unknown", type);
    return made ? Errc::ok : made.error().code;
  };
  EXPECT_EQ(code("example_interfaces/srv/AddTwoInts"), Errc::ok);
  EXPECT_EQ(code("example_interfaces/srv/AddNothing"), Errc::type_not_found);
  EXPECT_EQ(code("example_interfaces"), Errc::invalid_name);
}

}  // namespace
}  // namespace agnocast
