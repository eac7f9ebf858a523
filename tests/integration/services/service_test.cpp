// SPDX-License-Identifier: Apache-2.0
//
// Goal: requests get their responses, at once or later, once; and a request that cannot be
// answered ends with an error, at the right place, and soon.
// Method: the public interface with the real daemon, all in this process. Background executors
// run the nodes unless the test says otherwise. More processes: service_processes_test.cpp.

#include <tests/integration/services/service_fixture.hpp>

namespace agnocast {
namespace {

// --- requests and responses

TEST_F(Services, AnswerRequests) {
  Spun<Node> server("server"), asker("asker");
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

// A lifespan would let requests end without an answer, and different times would match nobody.
TEST_F(Services, UseOnlyTheDepthOfAQos) {
  using namespace std::chrono_literals;
  Spun<Node> server("server"), asker("asker");
  const QoS offered = QoS(10).lifespan(1ns).deadline(2h);
  const QoS requested = QoS(10)
                            .lifespan(1ns)
                            .deadline(1h)
                            .liveliness(Liveliness::manual_by_topic)
                            .liveliness_lease_duration(1h);
  auto service = server.create_service<Repeat>("repeat", answer, offered);
  auto client = asker.create_client<Repeat>("repeat", requested);
  ASSERT_TRUE(client->wait_for_service(patience));
  auto sent = client->async_send_request(ask_for(client, 7));
  ASSERT_TRUE(is_ready_soon(sent));
  EXPECT_EQ(sent.get()->values.front(), 7u);
}

TEST_F(Services, ServeAnythingThatHasTheNamesOfANode) {
  Spun<PlainNode> node;
  auto service = create_service<Repeat>(&node, "plain", answer);
  auto client = create_client<Repeat>(node, "plain");
  EXPECT_STREQ(client->get_service_name(), "/ns/plain");
  ASSERT_TRUE(client->wait_for_service(patience));
  auto sent = client->async_send_request(ask_for(client, 7));
  ASSERT_TRUE(is_ready_soon(sent));
  EXPECT_EQ(sent.get()->values.front(), 7u);
}

TEST_F(Services, CallTheClientBackWithItsFuture) {
  Spun<Node> node("node");
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
  EXPECT_EQ(sent.get()->values.front(), 8u) << "it is the future that was returned";
}

TEST_F(Services, TakeCallbacksOfEveryPromisedSignature) {
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
  Spun<Node> server("server"), asker("asker");
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

TEST_F(Services, ReleaseClientsThatCameAndWent) {
  Spun<Node> server("server"), asker("asker");
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
  ASSERT_TRUE(client->wait_for_service(patience)) << "no executor spins yet";
  auto sent = client->async_send_request(
      ask_for(client, 3),
      [&](const Client<Repeat>::SharedFuture&) { called = std::this_thread::get_id(); });
  EXPECT_EQ(executor.spin_until_future_complete(sent, patience), FutureReturnCode::SUCCESS);
  EXPECT_EQ(sent.get()->values.front(), 3u);
  EXPECT_EQ(served, std::this_thread::get_id());
  EXPECT_EQ(called, std::this_thread::get_id());
}

TEST_F(Services, GiveTheExceptionOfACallbackToTheSpinningCaller) {
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
  Spun<Node> server("server"), asker("asker");
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
  Spun<Node> server("server"), asker("asker");
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
  Spun<Node> server("server"), asker("asker");
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
  EXPECT_EQ(kept.answer(service, 0), Errc::ok) << "a failed response can be tried again";
  EXPECT_TRUE(is_ready_soon(sent));
}

TEST_F(Services, AnswerNoRequestAndSendNoLoanOfAnEarlierOne) {
  Spun<Node> server("server"), asker("asker");
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

TEST_F(Services, CanReleaseARequestBeforeTheyAnswer) {
  Spun<Node> server("server"), asker("asker");
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

// --- servers come and go

TEST_F(Services, AreWaitedForUntilAServerExists) {
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

TEST_F(Services, RefuseARequestWithoutAServer) {
  Node asker("asker");
  auto client = asker.create_client<Repeat>("nobody");
  auto request = ask_for(client, 9);
  const auto sent = client->try_async_send_request(std::move(request));
  ASSERT_FALSE(sent);
  EXPECT_EQ(sent.error().code, Errc::no_server);
  ASSERT_TRUE(request) << "the caller still has it";
  EXPECT_EQ(request->value, 9u);
  EXPECT_EQ(client->get_pending_request_count(), 0u);
  try {
    client->async_send_request(std::move(request));
    ADD_FAILURE() << "sent without a server";
  } catch (const Error& error) {
    EXPECT_EQ(error.failure().code, Errc::no_server);
    EXPECT_THAT(error.what(), testing::HasSubstr("/nobody"));
  }
}

TEST_F(Services, EndWithAnErrorForTheWaitingCaller) {
  Spun<Node> server("server"), asker("asker");
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
  EXPECT_EQ(error_of(answered), Errc::ok) << "earlier responses count";
  EXPECT_EQ(error_of(waits), Errc::no_server);
  auto code = called.get_future();
  ASSERT_TRUE(is_ready_soon(code));
  EXPECT_EQ(code.get(), Errc::no_server);
  EXPECT_EQ(client->get_pending_request_count(), 0u);
}

TEST_F(Services, EndWithAnErrorAlsoIfTheirLastResponseIsMalformed) {
  Node asker("asker");
  SingleThreadedExecutor spins_late;
  spins_late.add_node(asker);
  using Kind = detail::TypedService<Repeat>;
  const Kind::ResponseCode code;
  const Spun<Node> node_of_liar("liar");
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
      },
      nullptr);
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
  Spun<Node> server("server"), asker("asker");
  for (int round = 0; round < 100; ++round) {
    auto token = std::make_shared<int>(round);
    const std::weak_ptr<int> callback = token;
    auto service = server.create_service<Repeat>(
        "ended", [token = std::move(token)](const ipc_shared_ptr<const Repeat::Request>& request,
                                            ipc_shared_ptr<Repeat::Response>& response) {
          Repeat::answer(*request, *response);
        });
    // Meanwhile the library's thread of services makes the publisher to this client.
    auto client = asker.create_client<Repeat>("ended");
    service.reset();
    ASSERT_TRUE(callback.expired()) << "round " << round;
  }
}

TEST_F(Services, OfSeveralTheFirstResponseCounts) {
  Spun<Node> first("first"), second("second"), asker("asker");
  Kept kept_first, kept_second;
  auto one = first.create_service<Repeat>("several", kept_first.keep());
  auto two = second.create_service<Repeat>("several", kept_second.keep());
  auto client = asker.create_client<Repeat>("several");
  ASSERT_TRUE(eventually([&] { return client->get_server_count() == 2; }));
  auto sent = client->async_send_request(ask_for(client, 6));
  ASSERT_TRUE(eventually([&] { return kept_first.count() + kept_second.count() == 2; }));
  one.reset();
  EXPECT_EQ(kept_second.answer(two, 0), Errc::ok);
  EXPECT_EQ(error_of(sent), Errc::ok) << "the other server still had it";
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

}  // namespace
}  // namespace agnocast
