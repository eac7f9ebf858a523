// SPDX-License-Identifier: Apache-2.0
//
// A program without exceptions (-fno-exceptions), for no_exceptions_test.cpp: "use" makes one of
// everything and sends messages through it, "throw" calls a throwing function without a daemon.

#include <agnocast/agnocast.hpp>
#include <agnocast/generic.hpp>
#include <agnocast/generic_service.hpp>
#include <agnocast/relay.hpp>
#include <tests/integration/services/services.hpp>
#include <tests/support/processes/plain_node.hpp>
#include <tests/support/processes/spun.hpp>

#include <cstdint>
#include <cstdio>
#include <memory>
#include <string_view>
#include <utility>
#include <vector>

#if defined(__cpp_exceptions)
#error "this program is to have none"
#endif

struct Numbers {
  std::vector<std::uint64_t> values;
};
template <>
struct agnocast::MessageTraits<Numbers> {
  static constexpr const char* name = "tests/Numbers";
  static void for_each_pointer(const Numbers& numbers, PointerVisitor& visit) noexcept {
    visit("values", numbers.values);
  }
};

namespace {

using namespace agnocast;
using test::PlainNode;
using test::Repeat;

int failed(const char* what, const char* why = "") {
  std::printf("%s: %s\n", what, why);
  return 1;
}

int use() {
  auto subscription = try_create_subscription<Numbers>(PlainNode(), "/numbers", QoS(10));
  auto publisher = try_create_publisher<Numbers>(PlainNode(), "/numbers", QoS(10));
  if (!subscription || !publisher) return failed("endpoints");
  // Outside the shared heap, so that publish copies it.
  const auto made = [](std::size_t count) {
    const LoanPause elsewhere;
    auto numbers = std::make_unique<Numbers>();
    numbers->values.assign(count, 7);
    return numbers;
  };
  PublishResult result = (*publisher)->publish(made(1'000));
  if (!result) return failed("publish", sentence_of(result.code));
  const auto taken = test::take_soon(*subscription);
  if (!taken || taken->values != std::vector<std::uint64_t>(1'000, 7)) return failed("take");
  // More than the heap has, 512 MiB.
  result = (*publisher)->publish(made(std::size_t{64} << 20));
  if (result.code != Errc::heap_exhausted && result.code != Errc::window_exhausted)
    return failed("publish without room", sentence_of(result.code));

  test::Spun<PlainNode> node;
  auto service = try_create_service<Repeat>(node, "/repeat",
                                            [](const ipc_shared_ptr<const Repeat::Request>& request,
                                               const ipc_shared_ptr<Repeat::Response>& response) {
                                              Repeat::answer(*request, *response);
                                            });
  auto client = try_create_client<Repeat>(node, "/repeat");
  if (!service || !client || !(*client)->wait_for_service(std::chrono::minutes(5)))
    return failed("service");
  auto request = (*client)->borrow_loaned_request();
  request->value = 3;
  request->count = 100;
  auto sent = (*client)->try_async_send_request(std::move(request));
  if (!sent) return failed("request");
  if (sent->future.get()->values.size() != 100) return failed("response");

  if (!try_find_message_type("no_such/msg/Type")) std::printf("ok\n");
  return 0;
}

/// Instantiated and not called: each throws.
[[maybe_unused]] void make_everything() {
  (void)create_publisher<Numbers>(PlainNode(), "/a", QoS(1));
  (void)create_subscription<Numbers>(PlainNode(), "/a", QoS(1));
  (void)create_client<Repeat>(PlainNode(), "/a")->async_send_request({});
  (void)create_service<Repeat>(
      PlainNode(), "/a",
      [](const ipc_shared_ptr<const Repeat::Request>&, const ipc_shared_ptr<Repeat::Response>&) {});
  const auto publisher = create_generic_publisher(PlainNode(), "/a", "a/msg/A", QoS(1));
  (void)create_generic_subscription(
      PlainNode(), "/a", "a/msg/A", QoS(1),
      [](GenericMessage message) { (void)try_copy_checked(message); });
  (void)create_generic_client(PlainNode(), "/a", "a/srv/A");
  SharedVector<int>(1).resize(2);
}

}  // namespace

int main(int count, char** arguments) {
  if (count == 2 && std::string_view(arguments[1]) == "use") return use();
  if (count == 2 && std::string_view(arguments[1]) == "throw") {
    (void)agnocast::create_publisher<Numbers>(PlainNode(), "/numbers", QoS(1));
    return 0;
  }
  if (count == 3) make_everything();
  return 2;
}
