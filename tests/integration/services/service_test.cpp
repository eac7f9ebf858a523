// SPDX-License-Identifier: Apache-2.0
//
// Goal: requests get their responses, at once or later, once; and what cannot be answered ends with an
// error, where it should, and soon.
// Method: the public interface with the real daemon, all in this process. Nodes are run by the
// library's threads unless the test says otherwise. More processes: service_processes_test.cpp.

#include <tests/integration/services/services.hpp>
#include <tests/support/daemon_process.hpp>
#include <tests/support/plain_node.hpp>

#include <agnocast/abi/heaphook.h>

#include <gmock/gmock.h>

#include <array>
#include <chrono>
#include <cstdlib>
#include <functional>
#include <future>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

namespace agnocast {
namespace {

using namespace std::chrono_literals;
using test::Count;
using test::eventually;
using test::PlainNode;
using test::Repeat;

constexpr auto patience = 20s;

class Services : public testing::Test {
 protected:
  // The library connects once per process, so all tests here share one daemon.
  static void SetUpTestSuite() {
    test::DaemonOptions options;
    options.config = "[heap]\nwindow_bytes = \"64MiB\"\n" AGNOCAST_TEST_ARENA_BASE;
    daemon = new test::DaemonProcess(options);
    ::setenv("AGNOCAST_SOCKET", daemon->socket_path().c_str(), 1);
  }
  static void TearDownTestSuite() { delete daemon; }
  static test::DaemonProcess* daemon;
};
test::DaemonProcess* Services::daemon = nullptr;

void answer(const ipc_shared_ptr<const Repeat::Request>& request,
            ipc_shared_ptr<Repeat::Response>& response) {
  Repeat::answer(*request, *response);
}

ipc_shared_ptr<Repeat::Request> ask_for(const Client<Repeat>::SharedPtr& client,
                                        std::uint64_t value) {
  auto request = client->borrow_loaned_request();
  request->value = value;
  request->count = 1000;
  request->note = "a note that is too long to be kept inside of its string";
  return request;
}

template <class FutureT>
bool is_ready_soon(const FutureT& future) {
  return future.wait_for(patience) == std::future_status::ready;
}
/// The code of the error that the future ends with; ok if it has a response.
template <class FutureT>
Errc error_of(FutureT& future) {
  if (!is_ready_soon(future)) return Errc::internal;
  try {
    (void)future.get();
    return Errc::ok;
  } catch (const Error& error) {
    return error.failure().code;
  }
}

/// Requests that wait for somebody to answer them.
struct Kept {
  std::mutex mutex;
  std::vector<ServiceRequest<Repeat>> requests;
  auto keep() {
    return [this](ServiceRequest<Repeat> request) {
      const std::lock_guard lock(mutex);
      requests.push_back(std::move(request));
    };
  }
  std::size_t count() {
    const std::lock_guard lock(mutex);
    return requests.size();
  }
  Errc answer(const Service<Repeat>::SharedPtr& service, std::size_t index) {
    const std::lock_guard lock(mutex);
    auto response = service->borrow_loaned_response();
    if (requests[index].message()) Repeat::answer(*requests[index], *response);
    return service->send_response(requests[index], std::move(response)).code;
  }
};

// --- requests and responses

TEST_F(Services, AnswerWhatTheyAreAsked) {
  Node server("server"), asker("asker");
  auto service = server.create_service<Repeat>("repeat", answer);
  auto client = asker.create_client<Repeat>("repeat");
  ASSERT_TRUE(client->wait_for_service(patience));
  for (std::uint64_t value = 1; value <= 100; ++value) {
    auto sent = client->async_send_request(ask_for(client, value));
    EXPECT_EQ(sent.request_id, static_cast<std::int64_t>(value));
    ASSERT_TRUE(is_ready_soon(sent));
    const auto response = sent.get();
    ASSERT_EQ(response->values.size(), 1000u);
    EXPECT_EQ(response->values.front(), value);
    EXPECT_EQ(response->values.back(), value);
    EXPECT_EQ(response->note, "a note that is too long to be kept inside of its string");
  }
  EXPECT_EQ(client->get_pending_request_count(), 0u);
  EXPECT_EQ(service->get_undelivered_response_count(), 0u);
  EXPECT_STREQ(client->get_service_name(), "/repeat");
  EXPECT_STREQ(service->get_service_name(), "/repeat");
}

TEST_F(Services, ServeAnythingThatHasTheNamesOfANode) {
  PlainNode node;
  auto service = create_service<Repeat>(&node, "plain", answer);
  auto client = create_client<Repeat>(node, "plain");
  EXPECT_STREQ(client->get_service_name(), "/ns/plain");
  ASSERT_TRUE(client->wait_for_service(patience));
  auto sent = client->async_send_request(ask_for(client, 7));
  ASSERT_TRUE(is_ready_soon(sent));
  EXPECT_EQ(sent.get()->values.front(), 7u);
}

TEST_F(Services, CallTheClientBackWithItsFuture) {
  Node node("node");
  auto service = node.create_service<Repeat>("called_back", answer);
  auto client = node.create_client<Repeat>("called_back");
  ASSERT_TRUE(client->wait_for_service(patience));
  std::promise<std::uint64_t> called;
  auto sent = client->async_send_request(
      ask_for(client, 8),
      [&](Client<Repeat>::SharedFuture future) { called.set_value(future.get()->values.front()); });
  auto value = called.get_future();
  ASSERT_TRUE(is_ready_soon(value));
  EXPECT_EQ(value.get(), 8u);
  ASSERT_TRUE(is_ready_soon(sent));
  EXPECT_EQ(sent.get()->values.front(), 8u) << "the future that was returned is the same";
}

TEST_F(Services, TakeCallbacksOfEveryPromisedShape) {
  Node node("node");
  using Request = Repeat::Request;
  using Response = Repeat::Response;
  EXPECT_TRUE(try_create_service<Repeat>(
      node, "s", [](ipc_shared_ptr<const Request>, ipc_shared_ptr<Response>&) {}));
  EXPECT_TRUE(try_create_service<Repeat>(
      node, "s", [](const ipc_shared_ptr<Request>&, ipc_shared_ptr<Response>&) {}));
  EXPECT_TRUE(try_create_service<Repeat>(
      node, "s", [](ipc_shared_ptr<const Request>&&, const ipc_shared_ptr<Response>&) {}));
  EXPECT_TRUE(try_create_service<Repeat>(node, "s", [](ServiceRequest<Repeat>&&) {}));
  EXPECT_TRUE(try_create_service<Repeat>(node, "s", [](const ServiceRequest<Repeat>&) {}));
}

TEST_F(Services, OfManyClientsAnswerEachItsOwn) {
  Node server("server"), asker("asker");
  auto service = server.create_service<Repeat>("many", answer);
  std::vector<Client<Repeat>::SharedPtr> clients;
  std::vector<std::pair<std::uint64_t, Client<Repeat>::Future>> asked;
  for (int i = 0; i < 12; ++i) clients.push_back(asker.create_client<Repeat>("many"));
  for (const auto& client : clients) ASSERT_TRUE(client->wait_for_service(patience));
  EXPECT_TRUE(eventually([&] { return service->get_client_count() == clients.size(); }));
  for (std::uint64_t round = 0; round < 5; ++round) {
    for (std::size_t i = 0; i < clients.size(); ++i) {
      const std::uint64_t value = 1000 * i + round;
      asked.emplace_back(value, clients[i]->async_send_request(ask_for(clients[i], value)).future);
    }
  }
  for (auto& [value, future] : asked) {
    ASSERT_TRUE(is_ready_soon(future));
    EXPECT_EQ(future.get()->values.front(), value);
  }
}

TEST_F(Services, LetGoOfClientsThatCameAndWent) {
  Node server("server"), asker("asker");
  auto service = server.create_service<Repeat>("guests", answer);
  for (std::uint64_t guest = 0; guest < 50; ++guest) {
    auto client = asker.create_client<Repeat>("guests");
    ASSERT_TRUE(client->wait_for_service(patience));
    auto sent = client->async_send_request(ask_for(client, guest));
    ASSERT_TRUE(is_ready_soon(sent));
    EXPECT_EQ(sent.get()->values.front(), guest);
  }
  EXPECT_TRUE(eventually([&] { return service->get_client_count() == 0; }));
  EXPECT_EQ(service->get_undelivered_response_count(), 0u);
}

// --- executors

TEST_F(Services, RunInAnExecutorAndAreReadyBeforeItSpins) {
  Node node("spun");
  SingleThreadedExecutor executor;
  executor.add_node(node);
  std::thread::id served, called;
  auto service =
      node.create_service<Repeat>("spun", [&](const ipc_shared_ptr<const Repeat::Request>& request,
                                              ipc_shared_ptr<Repeat::Response>& response) {
        served = std::this_thread::get_id();
        Repeat::answer(*request, *response);
      });
  auto client = node.create_client<Repeat>("spun");
  ASSERT_TRUE(client->wait_for_service(patience)) << "nobody spins yet";
  auto sent = client->async_send_request(
      ask_for(client, 3),
      [&](const Client<Repeat>::SharedFuture&) { called = std::this_thread::get_id(); });
  EXPECT_EQ(executor.spin_until_future_complete(sent, patience), FutureReturnCode::SUCCESS);
  EXPECT_EQ(sent.get()->values.front(), 3u);
  EXPECT_EQ(served, std::this_thread::get_id());
  EXPECT_EQ(called, std::this_thread::get_id());
}

TEST_F(Services, GiveTheExceptionOfACallbackToWhoeverSpins) {
  Node node("throws");
  SingleThreadedExecutor executor;
  executor.add_node(node);
  auto service = node.create_service<Repeat>(
      "throws", [&](const ipc_shared_ptr<const Repeat::Request>&,
                    ipc_shared_ptr<Repeat::Response>&) { throw std::string("no"); });
  auto client = node.create_client<Repeat>("throws");
  ASSERT_TRUE(client->wait_for_service(patience));
  auto sent = client->async_send_request(ask_for(client, 3));
  EXPECT_THROW(executor.spin_until_future_complete(sent, patience), std::string);
  EXPECT_EQ(client->get_pending_request_count(), 1u);
}

// --- later

TEST_F(Services, AnswerLaterInAnyOrderFromAnyThread) {
  Node server("server"), asker("asker");
  Kept kept;
  auto service = server.create_service<Repeat>("later", kept.keep());
  auto client = asker.create_client<Repeat>("later");
  ASSERT_TRUE(client->wait_for_service(patience));
  std::vector<Client<Repeat>::Future> futures;
  for (std::uint64_t value = 0; value < 8; ++value)
    futures.push_back(client->async_send_request(ask_for(client, value)).future);
  ASSERT_TRUE(eventually([&] { return kept.count() == 8; }));
  EXPECT_EQ(futures[0].wait_for(0s), std::future_status::timeout);
  std::thread other([&] {
    for (const std::size_t index : {5U, 2U, 7U, 0U})
      EXPECT_EQ(kept.answer(service, index), Errc::ok);
  });
  for (const std::size_t index : {6U, 1U, 3U}) EXPECT_EQ(kept.answer(service, index), Errc::ok);
  other.join();
  for (const std::size_t index : {0U, 1U, 2U, 3U, 5U, 6U, 7U}) {
    ASSERT_TRUE(is_ready_soon(futures[index]));
    EXPECT_EQ(futures[index].get()->values.front(), index);
  }
  EXPECT_EQ(futures[4].wait_for(0s), std::future_status::timeout) << "never answered";
  EXPECT_EQ(client->get_pending_request_count(), 1u);
}

TEST_F(Services, AnswerARequestOnce) {
  Node server("server"), asker("asker");
  Kept kept;
  auto service = server.create_service<Repeat>("once", kept.keep());
  auto client = asker.create_client<Repeat>("once");
  ASSERT_TRUE(client->wait_for_service(patience));
  auto sent = client->async_send_request(ask_for(client, 1));
  ASSERT_TRUE(eventually([&] { return kept.count() == 1; }));
  kept.requests.push_back(kept.requests[0]);
  EXPECT_EQ(kept.answer(service, 0), Errc::ok);
  EXPECT_EQ(kept.answer(service, 0), Errc::already_answered);
  EXPECT_EQ(kept.answer(service, 1), Errc::already_answered) << "a copy is the same request";
  ASSERT_TRUE(is_ready_soon(sent));
  EXPECT_EQ(client->get_dropped_response_count(), 0u);
}

TEST_F(Services, AnswerOnlyTheirOwnRequestsWithTheirOwnLoans) {
  Node server("server"), asker("asker");
  Kept kept;
  auto service = server.create_service<Repeat>("mine", kept.keep());
  auto other = server.create_service<Repeat>("others", kept.keep());
  auto client = asker.create_client<Repeat>("mine");
  ASSERT_TRUE(client->wait_for_service(patience));
  auto sent = client->async_send_request(ask_for(client, 1));
  ASSERT_TRUE(eventually([&] { return kept.count() == 1; }));
  EXPECT_EQ(kept.answer(other, 0), Errc::invalid_argument);
  EXPECT_EQ(other->send_response({}, other->borrow_loaned_response()).code, Errc::invalid_argument);
  EXPECT_EQ(service->send_response(kept.requests[0], other->borrow_loaned_response()).code,
            Errc::loan_invalid);
  EXPECT_EQ(kept.answer(service, 0), Errc::ok) << "what failed can be tried again";
  EXPECT_TRUE(is_ready_soon(sent));
}

TEST_F(Services, AnswerNoRequestAndSendNoLoanOfAnEarlierOne) {
  Node server("server"), asker("asker");
  Kept kept;
  std::vector<ipc_shared_ptr<Repeat::Response>> loans;
  auto client = asker.create_client<Repeat>("earlier");
  constexpr std::size_t rounds = 20;
  for (std::size_t round = 0; round < rounds; ++round) {
    auto service = server.create_service<Repeat>("earlier", kept.keep());
    ASSERT_TRUE(client->wait_for_service(patience));
    auto sent = client->async_send_request(ask_for(client, round));
    ASSERT_TRUE(eventually([&] { return kept.count() == round + 1; }));
    for (std::size_t i = 0; i < round; ++i) {
      EXPECT_EQ(kept.answer(service, i), Errc::invalid_argument) << i << " in " << round;
      EXPECT_EQ(service->send_response(kept.requests[round], std::move(loans[i])).code,
                Errc::loan_invalid)
          << i << " in " << round;
      ASSERT_TRUE(loans[i]) << "the caller still has it";
    }
    loans.push_back(service->borrow_loaned_response());
    EXPECT_TRUE(service->pause(loans.back()));
    service.reset();
    ASSERT_TRUE(eventually([&] { return !client->service_is_ready(); }));
  }
}

TEST_F(Services, SendNoRequestOfAnEarlierClient) {
  Node server("server"), asker("asker");
  auto service = server.create_service<Repeat>("successive", answer);
  std::vector<ipc_shared_ptr<Repeat::Request>> loans;
  for (std::uint64_t round = 0; round < 20; ++round) {
    auto client = asker.create_client<Repeat>("successive");
    ASSERT_TRUE(client->wait_for_service(patience));
    for (auto& loan : loans) {
      const auto sent = client->try_async_send_request(std::move(loan));
      ASSERT_FALSE(sent) << round;
      EXPECT_EQ(sent.error().code, Errc::loan_invalid);
      ASSERT_TRUE(loan) << "the caller still has it";
    }
    EXPECT_EQ(client->get_pending_request_count(), 0u);
    loans.push_back(ask_for(client, round));
    EXPECT_TRUE(client->pause(loans.back()));
  }
}

TEST_F(Services, CanLetGoOfARequestBeforeTheyAnswer) {
  Node server("server"), asker("asker");
  Kept kept;
  auto service = server.create_service<Repeat>("light", kept.keep());
  auto client = asker.create_client<Repeat>("light");
  ASSERT_TRUE(client->wait_for_service(patience));
  auto sent = client->async_send_request(ask_for(client, 1));
  ASSERT_TRUE(eventually([&] { return kept.count() == 1; }));
  kept.requests[0].release();
  EXPECT_FALSE(kept.requests[0].message());
  EXPECT_EQ(kept.requests[0].id().sequence, sent.request_id);
  EXPECT_EQ(kept.answer(service, 0), Errc::ok);
  ASSERT_TRUE(is_ready_soon(sent));
  EXPECT_TRUE(sent.get()->values.empty());
}

// --- who is there

TEST_F(Services, AreWaitedForUntilSomebodyServes) {
  Node asker("asker"), server("server");
  auto client = asker.create_client<Repeat>("awaited");
  EXPECT_FALSE(client->service_is_ready());
  EXPECT_FALSE(client->wait_for_service(0s));
  EXPECT_FALSE(client->wait_for_service(20ms));
  auto waiting = std::async(std::launch::async, [&] { return client->wait_for_service(); });
  auto service = server.create_service<Repeat>("awaited", answer);
  ASSERT_TRUE(is_ready_soon(waiting));
  EXPECT_TRUE(waiting.get());
  EXPECT_TRUE(client->service_is_ready());
  service.reset();
  EXPECT_TRUE(eventually([&] { return !client->service_is_ready(); }));
}

TEST_F(Services, RefuseARequestThatNobodyWouldAnswer) {
  Node asker("asker");
  auto client = asker.create_client<Repeat>("nobody");
  auto request = ask_for(client, 9);
  const auto sent = client->try_async_send_request(std::move(request));
  ASSERT_FALSE(sent);
  EXPECT_EQ(sent.error().code, Errc::no_server);
  ASSERT_TRUE(request) << "it is the caller's still";
  EXPECT_EQ(request->value, 9u);
  EXPECT_EQ(client->get_pending_request_count(), 0u);
  try {
    client->async_send_request(std::move(request));
    ADD_FAILURE() << "sent to nobody";
  } catch (const Error& error) {
    EXPECT_EQ(error.failure().code, Errc::no_server);
    EXPECT_THAT(error.what(), testing::HasSubstr("/nobody"));
  }
}

TEST_F(Services, ThatEndLeaveAnErrorToWhoeverWaits) {
  Node server("server"), asker("asker");
  Kept kept;
  auto service = server.create_service<Repeat>("ends", kept.keep());
  auto client = asker.create_client<Repeat>("ends");
  ASSERT_TRUE(client->wait_for_service(patience));
  auto answered = client->async_send_request(ask_for(client, 1));
  auto waits = client->async_send_request(ask_for(client, 2));
  std::promise<Errc> called;
  auto calls = client->async_send_request(
      ask_for(client, 3),
      [&](Client<Repeat>::SharedFuture future) { called.set_value(error_of(future)); });
  ASSERT_TRUE(eventually([&] { return kept.count() == 3; }));
  EXPECT_EQ(kept.answer(service, 0), Errc::ok);
  service.reset();
  EXPECT_EQ(error_of(answered), Errc::ok) << "what was answered before counts";
  EXPECT_EQ(error_of(waits), Errc::no_server);
  auto code = called.get_future();
  ASSERT_TRUE(is_ready_soon(code));
  EXPECT_EQ(code.get(), Errc::no_server);
  EXPECT_EQ(client->get_pending_request_count(), 0u);
}

TEST_F(Services, ThatEndLeaveAnErrorAlsoIfTheirLastResponseIsMalformed) {
  Node asker("asker");
  SingleThreadedExecutor spins_late;
  spins_late.add_node(asker);
  using Kind = detail::TypedService<Repeat>;
  const Kind::ResponseCode code;
  std::promise<Errc> lied;
  auto liar = detail::UntypedService::create(
      {"/malformed", "/liar"}, *Kind().types(), ServicesQoS(), code.code(),
      [&](const std::shared_ptr<detail::ServiceCore>& core, detail::Block* block) {
        const auto client = detail::id_of(static_cast<std::byte*>(block->message.load())).client;
        const ipc_shared_ptr<const std::byte> request(block);
        auto response = code.make();
        const auto publisher = detail::UntypedService::publisher_to(*core, client);
        const Errc sent =
            !publisher ? publisher.error().code
                       : (*publisher)->publish(code.start_of(response.get()), code.bytes() - 8, 0);
        if (sent == Errc::ok) (void)response.release();
        lied.set_value(sent);
      });
  ASSERT_TRUE(liar);
  auto client = asker.create_client<Repeat>("malformed");
  ASSERT_TRUE(client->wait_for_service(patience));
  auto sent = client->async_send_request(ask_for(client, 1));
  ASSERT_EQ(lied.get_future().get(), Errc::ok);
  liar->reset();
  ASSERT_TRUE(eventually([&] { return !client->service_is_ready(); }));
  ASSERT_EQ(spins_late.spin_until_future_complete(sent, patience), FutureReturnCode::SUCCESS);
  EXPECT_EQ(error_of(sent), Errc::no_server);
  EXPECT_EQ(client->get_pending_request_count(), 0u);
}

TEST_F(Services, HaveDestroyedTheirCallbackWhenTheyHaveEnded) {
  Node server("server"), asker("asker");
  for (int round = 0; round < 100; ++round) {
    auto token = std::make_shared<int>(round);
    const std::weak_ptr<int> callback = token;
    auto service = server.create_service<Repeat>(
        "ended", [token = std::move(token)](const ipc_shared_ptr<const Repeat::Request>& request,
                                            ipc_shared_ptr<Repeat::Response>& response) {
          Repeat::answer(*request, *response);
        });
    // The library's thread makes the way to this one meanwhile.
    auto client = asker.create_client<Repeat>("ended");
    service.reset();
    ASSERT_TRUE(callback.expired()) << "round " << round;
  }
}

TEST_F(Services, OfSeveralTheFirstResponseCounts) {
  Node first("first"), second("second"), asker("asker");
  Kept kept_first, kept_second;
  auto one = first.create_service<Repeat>("several", kept_first.keep());
  auto two = second.create_service<Repeat>("several", kept_second.keep());
  auto client = asker.create_client<Repeat>("several");
  ASSERT_TRUE(eventually([&] { return client->get_server_count() == 2; }));
  auto sent = client->async_send_request(ask_for(client, 6));
  ASSERT_TRUE(eventually([&] { return kept_first.count() + kept_second.count() == 2; }));
  one.reset();
  EXPECT_EQ(kept_second.answer(two, 0), Errc::ok);
  EXPECT_EQ(error_of(sent), Errc::ok) << "the other one had it still";
  ASSERT_TRUE(eventually([&] { return client->get_server_count() == 1; }));

  one = first.create_service<Repeat>("several", kept_first.keep());
  ASSERT_TRUE(eventually([&] { return client->get_server_count() == 2; }));
  sent = client->async_send_request(ask_for(client, 7));
  ASSERT_TRUE(eventually([&] { return kept_first.count() + kept_second.count() == 4; }));
  EXPECT_EQ(kept_first.answer(one, 1), Errc::ok);
  EXPECT_EQ(error_of(sent), Errc::ok);
  EXPECT_EQ(kept_second.answer(two, 1), Errc::ok);
  EXPECT_TRUE(eventually([&] { return client->get_dropped_response_count() == 1; }))
      << "the second one is dropped";
  EXPECT_EQ(client->get_pending_request_count(), 0u);
}

// --- exactly once

/// Copying its request, as publish does when it has to adopt one, runs what a test wants then.
struct Trap {
  static inline std::function<void()> on_copy;
  struct Request : SharedMessage {
    Request() = default;
    Request(const Request& other) : note(other.note) { on_copy(); }
    Request& operator=(const Request&) = default;
    SharedString note;
  };
  struct Response : SharedMessage {
    std::uint64_t number = 0;
  };
};

}  // namespace

template <>
struct MessageTraits<Trap::Request> {
  static constexpr const char* name = "tests/srv/Trap_Request";
  static void for_each_pointer(const Trap::Request& request, PointerVisitor& visit) noexcept {
    visit("note", request.note);
  }
};
template <>
struct MessageTraits<Trap::Response> {
  static constexpr const char* name = "tests/srv/Trap_Response";
};

namespace {

TEST_F(Services, SayOfARequestThatFailsEitherToTheCallerOrToTheCallback) {
  Node server("server"), asker("asker");
  auto service = server.create_service<Trap>("trap", [](const ServiceRequest<Trap>&) {});
  auto client = asker.create_client<Trap>("trap");
  ASSERT_TRUE(client->wait_for_service(patience));
  std::promise<void> called;
  auto call = called.get_future();
  int calls = 0;
  // The server ends, and the request is given up, while it is being sent; and then that fails.
  Trap::on_copy = [&] {
    service.reset();
    EXPECT_TRUE(is_ready_soon(call));
    throw std::string("no");
  };
  auto request = client->borrow_loaned_request();
  {
    const LoanPause private_memory;
    request->note = "a note that is too long to be kept inside of its string";
  }
  const auto sent =
      client->try_async_send_request(std::move(request), [&](const Client<Trap>::SharedFuture&) {
        if (++calls == 1) called.set_value();
      });
  ASSERT_TRUE(sent) << "the callback was called, and so it was not refused";
  EXPECT_FALSE(request) << "what was sent is the caller's no more";
  auto future = sent->future;
  EXPECT_EQ(error_of(future), Errc::no_server);
  EXPECT_EQ(calls, 1);
  EXPECT_EQ(client->get_pending_request_count(), 0u);
}

TEST_F(Services, RememberRequestsInPrivateMemory) {
  Node node("private");
  auto service = node.create_service<Repeat>("private", answer);
  auto client = node.create_client<Repeat>("private");
  ASSERT_TRUE(client->wait_for_service(patience));
  struct Callback {
    std::promise<bool>* is_shared;
    std::array<std::byte, 512> bulk = {};  // is kept elsewhere than in a std::function itself
    void operator()(const Client<Repeat>::SharedFuture&) const {
      is_shared->set_value(agnocast_heaphook()->owns(this) != 0);
    }
  };
  std::promise<bool> is_shared;
  auto open = client->borrow_loaned_request();  // this thread allocates shared memory
  const auto sent = client->async_send_request(ask_for(client, 1), Callback{&is_shared});
  auto answer_is = is_shared.get_future();
  ASSERT_TRUE(is_ready_soon(answer_is));
  EXPECT_FALSE(answer_is.get());
}

// --- cancelling

TEST_F(Services, DropTheResponseToARemovedRequest) {
  Node server("server"), asker("asker");
  Kept kept;
  auto service = server.create_service<Repeat>("removed", kept.keep());
  auto client = asker.create_client<Repeat>("removed");
  ASSERT_TRUE(client->wait_for_service(patience));
  auto removed = client->async_send_request(ask_for(client, 1));
  auto stays = client->async_send_request(ask_for(client, 2));
  EXPECT_TRUE(client->remove_pending_request(removed));
  EXPECT_FALSE(client->remove_pending_request(removed.request_id)) << "it is gone";
  EXPECT_THROW(removed.get(), std::future_error);
  ASSERT_TRUE(eventually([&] { return kept.count() == 2; }));
  EXPECT_EQ(kept.answer(service, 0), Errc::ok);
  EXPECT_EQ(kept.answer(service, 1), Errc::ok);
  EXPECT_EQ(error_of(stays), Errc::ok);
  EXPECT_EQ(client->get_dropped_response_count(), 1u);
  EXPECT_FALSE(client->remove_pending_request(stays.request_id)) << "it was answered";
}

TEST_F(Services, PruneRequestsAllOrByAge) {
  Node server("server"), asker("asker");
  Kept kept;
  auto service = server.create_service<Repeat>("pruned", kept.keep());
  auto client = asker.create_client<Repeat>("pruned");
  ASSERT_TRUE(client->wait_for_service(patience));
  bool was_called = false;
  auto old = client->async_send_request(
      ask_for(client, 1), [&](const Client<Repeat>::SharedFuture&) { was_called = true; });
  const auto sent = std::chrono::system_clock::now();
  auto middle = sent;
  while (middle == sent) middle = std::chrono::system_clock::now();
  auto young = client->async_send_request(ask_for(client, 2));
  std::vector<std::int64_t> pruned;
  EXPECT_EQ(client->prune_requests_older_than(middle, &pruned), 1u);
  EXPECT_THAT(pruned, testing::ElementsAre(old.request_id));
  EXPECT_EQ(client->get_pending_request_count(), 1u);
  EXPECT_EQ(client->prune_pending_requests(), 1u);
  EXPECT_EQ(client->get_pending_request_count(), 0u);
  EXPECT_THROW(young.get(), std::future_error);
  EXPECT_FALSE(was_called);
}

TEST_F(Services, AClientThatEndsBreaksItsFuturesAndIsNotAnswered) {
  Node server("server"), asker("asker");
  Kept kept;
  auto service = server.create_service<Repeat>("left", kept.keep());
  auto client = asker.create_client<Repeat>("left");
  ASSERT_TRUE(client->wait_for_service(patience));
  auto sent = client->async_send_request(ask_for(client, 1));
  ASSERT_TRUE(eventually([&] { return kept.count() == 1; }));
  client.reset();
  EXPECT_THROW(sent.get(), std::future_error);
  ASSERT_TRUE(eventually([&] { return service->get_client_count() == 0; }));
  EXPECT_EQ(kept.answer(service, 0), Errc::endpoint_gone);
}

// --- ending in a callback

TEST_F(Services, MayEndInTheirOwnCallbacks) {
  Node server("ending_server"), asker("ending_asker");  // a callback may end after the test
  Service<Repeat>::SharedPtr service;
  std::mutex assigning;
  {
    const std::lock_guard lock(assigning);
    service = server.create_service<Repeat>(
        "suicide",
        [&](const ipc_shared_ptr<const Repeat::Request>&, ipc_shared_ptr<Repeat::Response>&) {
          const std::lock_guard assigned(assigning);
          service.reset();
        });
  }
  auto client = asker.create_client<Repeat>("suicide");
  ASSERT_TRUE(client->wait_for_service(patience));
  std::promise<Errc> called;
  (void)client->async_send_request(ask_for(client, 1), [&](Client<Repeat>::SharedFuture future) {
    client.reset();
    called.set_value(error_of(future));
  });
  auto code = called.get_future();
  ASSERT_TRUE(is_ready_soon(code));
  EXPECT_EQ(code.get(), Errc::no_server);
  const std::lock_guard until_the_callback_has_ended(assigning);
}

// --- limits

TEST_F(Services, ThatDoNotReadMakeTheSenderGetAnError) {
  Node server("late_server"), asker("asker");
  SingleThreadedExecutor nobody_spins;
  nobody_spins.add_node(server);
  auto service = server.create_service<Repeat>("full", answer, 3);
  auto client = asker.create_client<Repeat>("full", 5);
  ASSERT_TRUE(client->wait_for_service(patience));
  std::vector<Client<Repeat>::Future> sent;
  Errc last = Errc::ok;
  for (std::uint64_t value = 0; value < 10 && last == Errc::ok; ++value) {
    auto request = ask_for(client, value);
    auto next = client->try_async_send_request(std::move(request));
    if (next) {
      sent.push_back(std::move(next->future));
    } else {
      last = next.error().code;
      EXPECT_TRUE(request);
    }
  }
  EXPECT_EQ(last, Errc::would_block);
  EXPECT_EQ(sent.size(), 3u) << "the smaller depth";
  EXPECT_EQ(client->get_pending_request_count(), 3u);
  for (auto& future : sent)
    EXPECT_EQ(nobody_spins.spin_until_future_complete(future, patience), FutureReturnCode::SUCCESS)
        << "nothing was overwritten";
}

TEST_F(Services, AClientThatDoesNotReadHoldsUpNobodyElse) {
  Node server("server"), reads("reads"), sleeps("sleeps");
  Kept kept;
  SingleThreadedExecutor nobody_spins;
  nobody_spins.add_node(sleeps);
  auto service = server.create_service<Repeat>("slow", kept.keep(), 4);
  auto sleeper = sleeps.create_client<Repeat>("slow", 4);
  auto reader = reads.create_client<Repeat>("slow", 4);
  ASSERT_TRUE(sleeper->wait_for_service(patience));
  ASSERT_TRUE(reader->wait_for_service(patience));
  for (std::size_t i = 0; i < 6; ++i) {
    (void)sleeper->async_send_request(ask_for(sleeper, i));
    ASSERT_TRUE(eventually([&] { return kept.count() == i + 1; }));
  }
  for (std::size_t i = 0; i < 4; ++i) EXPECT_EQ(kept.answer(service, i), Errc::ok);
  EXPECT_EQ(kept.answer(service, 4), Errc::would_block);
  auto sent = reader->async_send_request(ask_for(reader, 70));
  ASSERT_TRUE(eventually([&] { return kept.count() == 7; }));
  EXPECT_EQ(kept.answer(service, 6), Errc::ok);
  EXPECT_EQ(error_of(sent), Errc::ok);
  nobody_spins.spin_all(patience);
  EXPECT_EQ(kept.answer(service, 4), Errc::ok) << "now it has read";
  EXPECT_EQ(kept.answer(service, 5), Errc::ok);
}

TEST_F(Services, RefuseWhatTheyCannotBe) {
  Node node("node");
  const auto code = [&](const std::string& name, const QoS& qos) {
    const auto made = try_create_client<Repeat>(node, name, qos);
    return made ? Errc::ok : made.error().code;
  };
  EXPECT_EQ(code("name", QoS(1).best_effort()), Errc::invalid_argument);
  EXPECT_EQ(code("name", QoS(1).transient_local()), Errc::invalid_argument);
  EXPECT_EQ(code("name", QoS(0)), Errc::depth_refused);
  EXPECT_EQ(code("a b", QoS(1)), Errc::invalid_name);
  EXPECT_EQ(code(std::string(service_name_length_max - 1, 'a'), QoS(1)), Errc::ok);
  EXPECT_EQ(code(std::string(service_name_length_max, 'a'), QoS(1)), Errc::invalid_name);
  const auto topic = try_create_publisher<Repeat::Request>(node, "/_service/request/name", 1);
  ASSERT_FALSE(topic);
  EXPECT_EQ(topic.error().code, Errc::invalid_name);
  EXPECT_THAT(text_of(topic.error()), testing::HasSubstr("topics of services"));
}

TEST_F(Services, OfAnotherTypeAreRefusedAlsoWhenOnlyTheResponseDiffers) {
  Node node("node");
  auto service = node.create_service<Repeat>("typed", answer);
  const auto client = try_create_client<Count>(node, "typed");
  ASSERT_FALSE(client);
  EXPECT_EQ(client.error().code, Errc::type_mismatch);
}

// --- names

TEST_F(Services, AreRemappedAsTheCommandLineSays) {
  const char* const line[] = {"program", "--ros-args",        "-r", "both:=b",
                              "-r",      "rosservice://s:=t", "-r", "rostopic://o:=p"};
  init(8, line);
  Node node("node");
  EXPECT_EQ(node.resolve_service_name("both"), "/b");
  EXPECT_EQ(node.resolve_topic_name("both"), "/b");
  EXPECT_EQ(node.resolve_service_name("s"), "/t");
  EXPECT_EQ(node.resolve_topic_name("s"), "/s");
  EXPECT_EQ(node.resolve_service_name("o"), "/o");
  EXPECT_EQ(node.resolve_topic_name("o"), "/p");
  EXPECT_EQ(node.resolve_service_name("~/own"), "/node/own");
  const char* const none[] = {"program"};
  init(1, none);
}

TEST(ServiceNames, TellTopicsOfServicesFromOthers) {
  using Kind = TopicRole::Kind;
  const TopicRole request = role_of_topic(request_topic("/ns/name"));
  EXPECT_EQ(request.kind, Kind::request);
  EXPECT_EQ(request.service, "/ns/name");
  const TopicRole reply = role_of_topic(reply_topic("/ns/name", 0x0123456789abcdef));
  EXPECT_EQ(reply.kind, Kind::reply);
  EXPECT_EQ(reply.service, "/ns/name");
  EXPECT_EQ(reply.client, 0x0123456789abcdefu);
  EXPECT_EQ(role_of_topic(reply_topic("/s", ~std::uint64_t{0})).client, ~std::uint64_t{0});
  for (const char* const topic :
       {"", "/", "/points", "/_service", "/_service/request", "/_service/request/",
        "/_service/requests", "/_service/reply/c0123", "/_service/reply/c0123456789abcdef",
        "/_service/reply/c0123456789abcdeg/a", "/_service/reply/c0123456789abcdeF/a",
        "/_service/reply/c0X23456789abcdef/a", "/_service/reply/c+123456789abcde/a",
        "/_service/reply/c0123456789abcdefa", "/ns/_service/request/a"}) {
    EXPECT_EQ(role_of_topic(topic).kind, Kind::topic) << topic;
    EXPECT_EQ(role_of_topic(topic).service, "") << topic;
  }
}

}  // namespace
}  // namespace agnocast
