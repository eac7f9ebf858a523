// Checks every byte of every cloud.
#include "robot.hpp"

#include <chrono>
#include <cstdio>
#include <cstdlib>

static bool is_right(const Cloud& cloud) {
  if (cloud.data.size() != bytes_of(cloud.width)) return false;
  for (std::size_t i = 0; i < cloud.data.size(); ++i)
    if (cloud.data[i] != byte_of(cloud.width, i)) return false;
  return true;
}

int main(int argc, char** argv) try {
  const auto count = static_cast<std::uint32_t>(argc > 1 ? std::atoi(argv[1]) : 1);
  agnocast::Node node("counter");
  agnocast::SingleThreadedExecutor executor;
  executor.add_node(node);
  std::uint32_t clouds = 0, names = 0, wrong = 0;
  auto cloud_subscription =
      agnocast::create_subscription<Cloud>(node, "cloud_count", agnocast::QoS(100),
                                           [&](const agnocast::ipc_shared_ptr<const Cloud>& cloud) {
                                             if (cloud->width != clouds + 1 || !is_right(*cloud))
                                               ++wrong;
                                             ++clouds;
                                           });
  auto name_subscription = agnocast::create_subscription<Name>(
      node, "cloud_name", agnocast::QoS(100), [&](agnocast::ipc_shared_ptr<const Name> name) {
        if (name->data != name_of(names + 1)) ++wrong;
        ++names;
      });
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(60);
  while ((clouds < count || names < count) && std::chrono::steady_clock::now() < end)
    executor.spin_once(std::chrono::milliseconds(100));
  std::printf(
      wrong == 0 ? "%u clouds and %u names are right\n" : "%u clouds and %u names, not all right\n",
      clouds, names);
  return wrong == 0 && clouds == count && names == count ? 0 : 1;
} catch (const agnocast::Error& error) {
  std::fprintf(stderr, "counter: %s\n", error.what());
  return 1;
}
