// SPDX-License-Identifier: Apache-2.0

#include <examples/demo/report.hpp>

#include <langinfo.h>
#include <unistd.h>

#include <algorithm>
#include <clocale>
#include <cmath>
#include <cstdarg>
#include <cstdio>
#include <cstring>

namespace demo {
namespace {

// Columns of the plot: of 80, without the labels and the number behind the longest bar.
constexpr std::size_t plot_columns = 48;
constexpr std::size_t label_columns = 18;

// Pads text, which may contain a two-byte micro sign, on the left to `columns` columns.
std::string right(const std::string& text, std::size_t columns) {
  const auto shown = static_cast<std::size_t>(std::count_if(text.begin(), text.end(), [](char c) {
    return (static_cast<unsigned char>(c) & 0xc0) != 0x80;
  }));
  return std::string(columns > shown ? columns - shown : 0, ' ') + text;
}

}  // namespace

std::string format(const char* form, ...) {
  char text[256];
  std::va_list values;
  va_start(values, form);
  std::vsnprintf(text, sizeof text, form, values);
  va_end(values);
  return text;
}

std::string size_text(std::uint64_t bytes) {
  return bytes >= 1 << 20 ? format("%.0f MB", static_cast<double>(bytes) / (1 << 20))
                          : format("%.0f KB", static_cast<double>(bytes) / (1 << 10));
}

Report::Report() : terminal_(::isatty(STDOUT_FILENO) == 1) {
  std::setlocale(LC_CTYPE, "");
  utf8_ = std::strcmp(::nl_langinfo(CODESET), "UTF-8") == 0;
}

void Report::line(const std::string& text) {
  progress_ends();
  std::printf("%s\n", text.c_str());
  std::fflush(stdout);
}

void Report::heading(int number, const std::string& text) {
  line();
  line(format("[%d] ", number) + text);
}

void Report::progress(double done, const std::string& what) {
  const auto now = std::chrono::steady_clock::now();
  const int percent = static_cast<int>(done * 100);
  if (terminal_) {
    const auto filled = static_cast<std::size_t>(done * 30);
    std::printf("\r    %s%s %3d %%  %-28.28s", bar(filled, true).c_str(),
                bar(30 - filled, false).c_str(), percent, what.c_str());
    progress_shown_ = true;
  } else if (now - last_progress_ >= std::chrono::seconds(5)) {
    std::printf("    ... %d %%, %s\n", percent, what.c_str());
    last_progress_ = now;
  }
  std::fflush(stdout);
}

void Report::progress_ends() {
  if (progress_shown_) std::printf("\r%79s\r", "");
  progress_shown_ = false;
}

std::string Report::time_text(double nanoseconds) const {
  if (nanoseconds <= 0) return "-";
  if (nanoseconds < 1e6)
    return format(nanoseconds < 1e5 ? "%.1f %s" : "%.0f %s", nanoseconds / 1e3, micro());
  return format(nanoseconds < 1e8 ? "%.2f ms" : "%.0f ms", nanoseconds / 1e6);
}

const char* Report::micro() const { return utf8_ ? "\u00b5s" : "us"; }

std::string Report::bar(std::size_t length, bool filled) const {
  const char* const cell = utf8_ ? (filled ? "\u2588" : "\u2591") : (filled ? "#" : ".");
  std::string text;
  for (std::size_t i = 0; i < length; ++i) text += cell;
  return text;
}

void Report::table(const std::vector<Latency>& latencies) {
  const bool with_dds = std::any_of(latencies.begin(), latencies.end(),
                                    [](const Latency& row) { return row.dds_count > 0; });
  line(with_dds ? "              agnocast              Cyclone DDS          DDS/agnocast  messages"
                : "              agnocast");
  line(with_dds ? "      size       p50       p99         p50       p99         p50      of each"
                : "      size       p50       p99   messages");
  for (const Latency& row : latencies) {
    std::string text = right(size_text(row.bytes), 10) + right(time_text(row.agnocast_p50_ns), 10) +
                       right(time_text(row.agnocast_p99_ns), 10);
    if (with_dds) {
      text += right(time_text(row.dds_p50_ns), 12) + right(time_text(row.dds_p99_ns), 10);
      text += right(row.dds_count > 0 ? format("%.1f x", row.ratio) : "-", 12);
      text += right(format("%llu", static_cast<unsigned long long>(row.agnocast_count)), 13);
    } else {
      text += right(format("%llu", static_cast<unsigned long long>(row.agnocast_count)), 11);
    }
    line(text);
  }
}

// Bars whose length is the logarithm of the time; a tick at each power of ten.
void Report::plot(const std::vector<Latency>& latencies) {
  double least = 1e99, most = 0;
  for (const Latency& row : latencies) {
    for (const double ns : {row.agnocast_p50_ns, row.dds_p50_ns}) {
      if (ns <= 0) continue;
      least = std::min(least, ns);
      most = std::max(most, ns);
    }
  }
  if (most <= 0) return;
  const double from = std::floor(std::log10(least) - 0.01);
  const double decades = std::max(1.0, std::ceil(std::log10(most)) - from);
  const auto column = [&](double ns) {
    return static_cast<std::size_t>(std::lround((std::log10(ns) - from) / decades * plot_columns));
  };
  std::string scale(label_columns, ' ');
  std::size_t shown = label_columns;
  for (double power = from; power <= from + decades; ++power) {
    const double ns = std::pow(10.0, power);
    const std::string tick =
        ns < 1e6 ? format("%g %s", ns / 1e3, micro()) : format("%g ms", ns / 1e6);
    const std::size_t place = label_columns + column(ns);
    if (place + 6 > 80 || place < shown) continue;
    scale += std::string(place - shown, ' ') + "|" + tick;
    shown = place + 1 + tick.size() - (utf8_ && ns < 1e6 ? 1 : 0);
  }
  line("latency, p50, logarithmic:");
  line(scale);
  const auto draw = [&](const std::string& label, double ns, bool filled) {
    if (ns <= 0) return;
    line(label + bar(std::max<std::size_t>(1, column(ns)), filled) + " " + time_text(ns));
  };
  for (const Latency& row : latencies) {
    draw(right(size_text(row.bytes), 7) + " agnocast  ", row.agnocast_p50_ns, true);
    draw("          DDS     ", row.dds_p50_ns, false);
  }
}

}  // namespace demo
