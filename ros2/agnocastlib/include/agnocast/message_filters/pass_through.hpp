// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <agnocast/message_filters/simple_filter.hpp>

namespace agnocast::message_filters {

/// Passes on what it gets, from a filter or from add().
template <class M>
class PassThrough : public SimpleFilter<M> {
 public:
  using typename SimpleFilter<M>::MConstPtr;
  using typename SimpleFilter<M>::EventType;

  PassThrough() = default;
  template <class F>
  explicit PassThrough(F& filter) {
    connectInput(filter);
  }
  ~PassThrough() { input_.disconnect(); }

  template <class F>
  void connectInput(F& filter) {
    input_.disconnect();
    input_ = filter.registerCallback(
        typename SimpleFilter<M>::EventCallback([this](const EventType& event) { add(event); }));
  }
  void add(const MConstPtr& message) { add(EventType(message)); }
  void add(const EventType& event) { this->signalMessage(event); }

 private:
  Connection input_;
};

}  // namespace agnocast::message_filters
