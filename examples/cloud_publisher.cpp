// SPDX-License-Identifier: Apache-2.0
//
// Publishes PointCloud2 messages built with push_back, resize, assign and insert; or replays a
// raw scan of 3 to 5 float32 per point (x y z intensity ring). With
// agnocast-run cloud_publisher it copies nothing.

#include <agnocast/agnocast.hpp>
#include <examples/cloud.hpp>
#include <examples/options.hpp>

#include <chrono>
#include <cstdio>
#include <string>
#include <thread>

int main(int argc, char** argv) try {
  const example::Options options =
      example::parse(argc, argv, "points", " [--points N | --scan FILE [--fields N]]");
  example::Scan scan;
  if (const std::string wrong =
          options.scan.empty() ? "" : example::read_scan(options.scan, options.fields, scan);
      !wrong.empty()) {
    std::fprintf(stderr,
                 "cloud_publisher: %s: %s\nhint: cloud_publisher --help describes the files\n",
                 options.scan.c_str(), wrong.c_str());
    return 1;
  }
  agnocast::Node node("cloud_publisher");
  auto publisher = node.create_publisher<example::Cloud>(options.topic, options.depth);
  auto next = std::chrono::steady_clock::now();
  for (std::uint64_t number = 1; options.count == 0 || number <= options.count; ++number) {
    auto message = publisher->borrow_loaned_message();
    example::fill(*message, number, options.points, scan);
    const std::size_t bytes = message->data.size();
    const auto result = publisher->publish(std::move(message));
    if (!result) {
      std::fprintf(stderr, "cloud_publisher: publish: %s\nhint: %s\n",
                   agnocast::sentence_of(result.code), agnocast::remedy_of(result.code));
      return 1;
    }
    if (options.verbose) {
      std::printf("published %llu: %zu bytes, %llu adopted\n",
                  static_cast<unsigned long long>(number), bytes,
                  static_cast<unsigned long long>(result.adopted_bytes));
      std::fflush(stdout);
    }
    std::this_thread::sleep_until(next += std::chrono::duration_cast<std::chrono::nanoseconds>(
                                      std::chrono::duration<double>(1 / options.rate)));
  }
  return 0;
} catch (const agnocast::Error& error) {
  std::fprintf(stderr, "cloud_publisher: %s\nhint: %s\n", error.what(),
               agnocast::remedy_of(error.failure().code));
  return 1;
}
