// SPDX-License-Identifier: Apache-2.0
//
// Services and clients as code for the kernel-module system, and for its later versions, writes
// them; and what happens to requests that nobody answers.

#include "common.hpp"

#include <std_srvs/srv/set_bool.hpp>

#include <atomic>
#include <future>
#include <optional>
#include <stdexcept>

namespace agnocastlib {
namespace {

using SetBool = std_srvs::srv::SetBool;
using Client = agnocast::Client<SetBool>;
using Service = agnocast::Service<SetBool>;

class ServicesTest : public AgnocastTest {
 protected:
  void SetUp() override {
    AgnocastTest::SetUp();
    node_ = std::make_shared<rclcpp::Node>("node");
    executor_ = std::make_unique<agnocast::CallbackIsolatedAgnocastExecutor>();
    executor_->add_node(node_);
    spinning_.emplace(*executor_);
  }
  void TearDown() override {
    spinning_.reset();
    executor_.reset();
    node_.reset();
    AgnocastTest::TearDown();
  }
  agnocast::ipc_shared_ptr<Client::RequestT> request_of(Client& client, bool data) {
    auto request = client.borrow_loaned_request();
    request->data = data;
    return request;
  }

  rclcpp::Node::SharedPtr node_;
  std::unique_ptr<agnocast::CallbackIsolatedAgnocastExecutor> executor_;
  std::optional<Spinning<agnocast::CallbackIsolatedAgnocastExecutor>> spinning_;
};

TEST_F(ServicesTest, TheResponseIsFilledByReference) {
  const auto service = agnocast::create_service<SetBool>(
      node_.get(), "service",
      [](const agnocast::ipc_shared_ptr<Service::RequestT>& request,
         agnocast::ipc_shared_ptr<Service::ResponseT>& response) {
        response->message = request->data ? "yes" : "no";
      });
  const auto client = agnocast::create_client<SetBool>(node_.get(), "service");
  EXPECT_STREQ(client->get_service_name(), "/service");
  ASSERT_TRUE(client->wait_for_service(30s));
  EXPECT_TRUE(client->service_is_ready());
  std::promise<std::string> called;
  client->async_send_request(request_of(*client, true), [&](Client::SharedFuture future) {
    called.set_value(future.get()->message);
  });
  EXPECT_EQ(called.get_future().get(), "yes");
  auto future = client->async_send_request(request_of(*client, false));
  EXPECT_EQ(future.get()->message, "no");
}

TEST_F(ServicesTest, TheResponseIsFilledThroughAnRvalueThatIsKept) {
  agnocast::ipc_shared_ptr<SetBool::Response> kept;
  const auto service = agnocast::create_service<SetBool>(
      node_.get(), "service",
      [&](agnocast::ipc_shared_ptr<const SetBool::Request>&& request,
          agnocast::ipc_shared_ptr<SetBool::Response>&& response) {
        kept = std::move(response);
        kept->success = request->data;
      },
      rclcpp::ServicesQoS(), node_->create_callback_group(rclcpp::CallbackGroupType::Reentrant));
  const auto client = agnocast::create_client<SetBool>(node_.get(), "service");
  ASSERT_TRUE(client->wait_for_service(30s));
  EXPECT_TRUE(client->async_send_request(request_of(*client, true)).get()->success);
  EXPECT_FALSE(kept) << "it was sent";
}

TEST_F(ServicesTest, ARequestWithoutAServerIsLoggedAndItsFutureThrows) {
  const LogLines lines;
  const auto client = agnocast::create_client<SetBool>(node_.get(), "nobody");
  EXPECT_FALSE(client->wait_for_service(10ms));
  auto future = client->async_send_request(request_of(*client, true));
  try {
    (void)future.get();
    ADD_FAILURE() << "nothing was thrown";
  } catch (const agnocast::Error& error) {
    EXPECT_EQ(error.failure().code, agnocast::Errc::no_server);
  }
  EXPECT_THAT(lines.with("a request to '/nobody' failed: no_server"), testing::SizeIs(1));
}

TEST_F(ServicesTest, ACallbackIsNotCalledIfTheServerEnds) {
  const LogLines lines;
  std::promise<void> has_request;
  std::promise<void> may_end;
  auto ending = may_end.get_future().share();
  // Takes the request and throws, so that it answers nothing, in an executor of its own.
  const auto other = std::make_shared<rclcpp::Node>("other");
  auto service =
      agnocast::create_service<SetBool>(other.get(), "service",
                                        [&](const agnocast::ipc_shared_ptr<SetBool::Request>&,
                                            agnocast::ipc_shared_ptr<SetBool::Response>&) {
                                          has_request.set_value();
                                          ending.wait();
                                          throw std::runtime_error("no answer");
                                        });
  agnocast::SingleThreadedAgnocastExecutor executor;
  executor.add_node(other);
  std::thread serving([&] { EXPECT_THROW(executor.spin(), std::runtime_error); });
  const auto client = agnocast::create_client<SetBool>(node_.get(), "service");
  ASSERT_TRUE(client->wait_for_service(30s));
  std::atomic<bool> is_called{false};
  const auto sent = client->async_send_request(request_of(*client, true),
                                               [&](Client::SharedFuture) { is_called = true; });
  has_request.get_future().wait();
  may_end.set_value();
  serving.join();
  service.reset();
  ASSERT_EQ(sent.future.wait_for(30s), std::future_status::ready);
  EXPECT_THROW((void)sent.future.get(), agnocast::Error);
  EXPECT_THAT(lines.with("a request to '/service' failed: no_server"), testing::SizeIs(1));
  EXPECT_FALSE(is_called);
}

TEST_F(ServicesTest, WaitingEndsWithRclcpp) {
  const auto client = agnocast::create_client<SetBool>(node_.get(), "nobody");
  std::thread ending([] {
    std::this_thread::sleep_for(50ms);
    rclcpp::shutdown();
  });
  EXPECT_FALSE(client->wait_for_service());
  ending.join();
}

}  // namespace
}  // namespace agnocastlib
