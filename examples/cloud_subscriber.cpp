// SPDX-License-Identifier: Apache-2.0
//
// Receives the clouds of cloud_publisher and checks every member of each. Exits with status 1 if
// one was wrong. With --scan FILE the clouds must be replays of that file.

#include <agnocast/agnocast.hpp>
#include <examples/cloud.hpp>
#include <examples/options.hpp>

#include <cstdint>
#include <cstdio>
#include <string>

int main(int argc, char** argv) try {
  const example::Options options =
      example::parse(argc, argv, "points", " [--scan FILE [--fields N]]");
  example::Scan scan;
  if (const std::string wrong =
          options.scan.empty() ? "" : example::read_scan(options.scan, options.fields, scan);
      !wrong.empty()) {
    std::fprintf(stderr,
                 "cloud_subscriber: %s: %s\nhint: give the file that cloud_publisher replays, and "
                 "its --fields\n",
                 options.scan.c_str(), wrong.c_str());
    return 1;
  }
  agnocast::Node node("cloud_subscriber");
  agnocast::SingleThreadedExecutor executor;
  executor.add_node(node);
  example::end_by_signal(executor);
  std::uint64_t received = 0, wrong = 0;
  auto subscription = node.create_subscription<example::Cloud>(
      options.topic, options.depth,
      [&](const agnocast::ipc_shared_ptr<const example::Cloud>& cloud) {
        const bool right = example::check(*cloud, cloud.info().sequence, scan);
        if (!right) ++wrong;
        if (options.verbose) {
          std::printf("received %llu: %u points at %p, %s\n",
                      static_cast<unsigned long long>(cloud.info().sequence), cloud->width,
                      static_cast<const void*>(cloud->data.data()), right ? "intact" : "WRONG");
          std::fflush(stdout);
        }
        if (++received == options.count) executor.cancel();
      });
  executor.spin();
  std::printf("%llu received, %llu wrong, %llu lost\n", static_cast<unsigned long long>(received),
              static_cast<unsigned long long>(wrong),
              static_cast<unsigned long long>(subscription->get_lost_count()));
  return wrong == 0 ? 0 : 1;
} catch (const agnocast::Error& error) {
  std::fprintf(stderr, "cloud_subscriber: %s\nhint: %s\n", error.what(),
               agnocast::remedy_of(error.failure().code));
  return 1;
}
