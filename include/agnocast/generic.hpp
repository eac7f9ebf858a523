// SPDX-License-Identifier: Apache-2.0
//
// Publishers and subscriptions whose message type is found at run time by its ROS name: for
// bridges, recorders, tools. Names follow rclcpp. Processes exchange the message object itself,
// not serialized bytes: a GenericMessage is the publisher's message with rosidl's introspection
// table to read it by; a GenericLoan is one to fill.
//
// A type is loaded from the introspection library of its package, which every ROS 2 message
// package has. Generic and typed endpoints of one type match each other and cost the same.
#pragma once

#include <agnocast/core_namespace.hpp>
#include <agnocast/publisher.hpp>
#include <agnocast/rosidl.hpp>
#include <agnocast/subscription.hpp>
#include <agnocast/type_library.hpp>

#include <rosidl_runtime_c/message_type_support_struct.h>

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <functional>
#include <memory>
#include <new>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

namespace agnocast {

/// rosidl's tables. Offsets are from the start of the message object; the functions for sequences
/// take the address of the member.
using MessageMembers = detail::RosMembers;
using MessageMember = detail::RosMember;

namespace detail {

/// Returns alignof the struct that rosidl generated for `members`.
inline std::uint32_t ros_alignment(const RosMembers& members) noexcept {
  namespace ros = rosidl_typesupport_introspection_cpp;
  std::uint32_t alignment = 1;
  for (std::uint32_t i = 0; i < members.member_count_; ++i) {
    const RosMember& member = members.members_[i];
    std::uint32_t own = alignof(std::vector<char>);
    if (!member.is_array_ || (member.array_size_ != 0 && !member.is_upper_bound_)) {
      own = member.type_id_ == ros::ROS_TYPE_MESSAGE
                ? ros_alignment(nested_members(member))
                : ros_element_layout(member.type_id_).alignment;
    }
    alignment = std::max(alignment, own);
  }
  return alignment;
}

/// Copies a message member by member, as T(const T&) would. `to` is a constructed message. May
/// throw bad_alloc and leaves `to` a valid message then.
inline void copy_by_table(const RosMembers& members, const void* from, void* to) {
  namespace ros = rosidl_typesupport_introspection_cpp;
  const auto copy_elements = [](const RosMember& member, const std::byte* source, std::byte* target,
                                std::size_t count) {
    switch (member.type_id_) {
      case ros::ROS_TYPE_MESSAGE: {
        const RosMembers& nested = nested_members(member);
        for (std::size_t i = 0; i < count; ++i)
          copy_by_table(nested, source + i * nested.size_of_, target + i * nested.size_of_);
        break;
      }
      case ros::ROS_TYPE_STRING:
        std::copy_n(reinterpret_cast<const std::string*>(source), count,
                    reinterpret_cast<std::string*>(target));
        break;
      case ros::ROS_TYPE_WSTRING:
        std::copy_n(reinterpret_cast<const std::u16string*>(source), count,
                    reinterpret_cast<std::u16string*>(target));
        break;
      default:
        std::memcpy(target, source, count * ros_element_layout(member.type_id_).bytes);
    }
  };
  for (std::uint32_t i = 0; i < members.member_count_; ++i) {
    const RosMember& member = members.members_[i];
    const auto* const source = static_cast<const std::byte*>(from) + member.offset_;
    auto* const target = static_cast<std::byte*>(to) + member.offset_;
    if (!member.is_array_) {
      copy_elements(member, source, target, 1);
    } else if (member.array_size_ != 0 && !member.is_upper_bound_) {
      copy_elements(member, source, target, member.array_size_);
    } else if (member.type_id_ == ros::ROS_TYPE_BOOLEAN) {
      *reinterpret_cast<std::vector<bool>*>(target) =
          *reinterpret_cast<const std::vector<bool>*>(source);
    } else if (const std::size_t count = member.size_function(source); count == 0) {
      member.resize_function(target, 0);
    } else {
      member.resize_function(target, count);
      copy_elements(member, static_cast<const std::byte*>(member.get_const_function(source, 0)),
                    static_cast<std::byte*>(member.get_function(target, 0)), count);
    }
  }
}

struct EndByTable {
  const RosMembers* members = nullptr;
  void operator()(std::byte* message) const noexcept {
    members->fini_function(message);
    ::operator delete(message);
  }
  static MessageEnd of(const RosMembers& members) noexcept {
    return {[](const void* table, void* message) noexcept {
              EndByTable{static_cast<const RosMembers*>(table)}(static_cast<std::byte*>(message));
            },
            &members};
  }
};

}  // namespace detail

/// A message of a type found at run time, in private memory.
using OwnedGenericMessage = std::unique_ptr<std::byte, detail::EndByTable>;

namespace detail {

struct CodeByTable {
  using Owner = OwnedGenericMessage;
  static constexpr bool copy_may_throw = true;
  const RosMembers* members;

  Owner make(rosidl_runtime_cpp::MessageInitialization how =
                 rosidl_runtime_cpp::MessageInitialization::ALL) const {
    const auto free = [](void* memory) { ::operator delete(memory); };
    std::unique_ptr<void, decltype(free)> memory(::operator new(members->size_of_), free);
    members->init_function(memory.get(), how);
    return own(static_cast<std::byte*>(memory.release()));
  }
  Owner copy(const std::byte& original) const {
    Owner made = make(rosidl_runtime_cpp::MessageInitialization::SKIP);
    copy_by_table(*members, &original, made.get());
    return made;
  }
  Owner own(std::byte* message) const noexcept { return Owner(message, EndByTable{members}); }
  void* start_of(std::byte* message) const noexcept { return message; }
  std::size_t bytes() const noexcept { return members->size_of_; }
};

}  // namespace detail

/// A message type found by its name. A pointer: cheap to copy, valid as long as the process
/// lives. Any thread.
class IntrospectedType {
 public:
  /// Uses an existing table, which must live as long as the process.
  explicit IntrospectedType(const MessageMembers& members) noexcept : members_(&members) {}

  const MessageMembers& members() const noexcept { return *members_; }
  /// Returns the type that endpoints are matched by; equal to message_type_of<T>() of the same
  /// message, with the same errors and cost.
  [[nodiscard]] Result<MessageType> message_type() const noexcept {
    const detail::TableReader reader{&detail::read_ros_message, &detail::read_ros_field,
                                     &detail::construct_ros_message, &detail::destroy_ros_message};
    return detail::make_described_type(reader, members_, detail::ros_alignment(*members_),
                                       detail::build_hash);
  }
  /// Return a default message, and a copy of one of this type. Throw what message constructors
  /// throw: std::bad_alloc.
  OwnedGenericMessage make() const { return detail::CodeByTable{members_}.make(); }
  OwnedGenericMessage copy(const void* message) const {
    return detail::CodeByTable{members_}.copy(*static_cast<const std::byte*>(message));
  }
  /// Makes `to` equal to `from`; both are messages of this type. Throws std::bad_alloc; `to` is
  /// then a valid mixture of both.
  void assign(const void* from, void* to) const { detail::copy_by_table(*members_, from, to); }

 private:
  const MessageMembers* members_;
};

/// Finds the type with this ROS name: "sensor_msgs/msg/PointCloud2", short
/// "sensor_msgs/PointCloud2"; a part of a service is "sensor_msgs/srv/SetCameraInfo_Request".
/// Searches for the introspection library of its package
/// (lib<package>__rosidl_typesupport_introspection_cpp.so), and for the libraries that this one
/// needs, in the directories `paths`, in lib/ of each prefix of AMENT_PREFIX_PATH, then where the
/// loader searches. The library is loaded once and stays; later calls for the package do not
/// search. Any thread. Loading takes milliseconds and runs that library's initialisers. Errors:
/// invalid_name; type_not_found with the searched places; shut_down in a forked child.
[[nodiscard]] inline Result<IntrospectedType> try_find_message_type(
    const std::string& name, const std::vector<std::string>& paths = {}) {
  const Result<void*> found = detail::find_type_support(name, paths);
  if (!found) return tl::unexpected<Failure>(found.error());
  const auto support = reinterpret_cast<const rosidl_message_type_support_t* (*)()>(*found)();
  if (support == nullptr || support->data == nullptr)
    return fail(Errc::type_refused, "the type support of the message has no introspection table");
  return IntrospectedType(*static_cast<const MessageMembers*>(support->data));
}
/// The same; throws Error.
inline IntrospectedType find_message_type(const std::string& name,
                                          const std::vector<std::string>& paths = {}) {
  const auto found = try_find_message_type(name, paths);
  if (!found) detail::throw_error(found.error());
  return *found;
}

/// A message in shared memory with its table. Copies share it, as copies of ipc_shared_ptr do.
template <class Byte>
class BasicGenericMessage {
 public:
  using Void = std::conditional_t<std::is_const_v<Byte>, const void, void>;

  BasicGenericMessage() noexcept = default;
  BasicGenericMessage(ipc_shared_ptr<Byte> message, const MessageMembers* members) noexcept
      : message_(std::move(message)), members_(members) {}

  /// Returns the message object; null if empty, published or moved from.
  Void* get() const noexcept { return message_.get(); }
  explicit operator bool() const noexcept { return get() != nullptr; }
  /// Null if the subscription was created for a TypeIdentity alone, or this is default
  /// constructed.
  const MessageMembers* members() const noexcept { return members_; }
  const MessageInfo& info() const noexcept { return message_.info(); }
  void reset() noexcept { message_.reset(); }
  /// For LoanScope and pause().
  const ipc_shared_ptr<Byte>& handle() const noexcept { return message_; }
  ipc_shared_ptr<Byte>& handle() noexcept { return message_; }

 private:
  ipc_shared_ptr<Byte> message_;
  const MessageMembers* members_ = nullptr;
};

/// A received message: read-only memory of its publisher. Its content belongs to another process:
/// strings and sequences of a hostile publisher may point anywhere, as in any received message.
using GenericMessage = BasicGenericMessage<const std::byte>;
/// A message to fill through the functions of its table.
using GenericLoan = BasicGenericMessage<std::byte>;

AGNOCAST_CORE_BEGIN

/// A Publisher of a type found at run time: publish(), publish_for(), pause() and the rest are
/// the same. Any thread may call any function.
class GenericPublisher : public detail::LendingPublisher<std::byte, detail::CodeByTable> {
 public:
  using SharedPtr = std::shared_ptr<GenericPublisher>;

  /// For create_generic_publisher.
  GenericPublisher(std::shared_ptr<detail::UntypedPublisher> untyped,
                   const MessageMembers& members) noexcept
      : LendingPublisher(std::move(untyped), detail::CodeByTable{&members}), members_(&members) {}

  /// Lends a default message to fill; see Publisher::borrow_loaned_message.
  GenericLoan borrow_loaned_message() { return {lend(), members_}; }
  using LendingPublisher::publish;
  /// See LendingPublisher::publish.
  PublishResult publish(GenericLoan&& loan) noexcept { return publish(std::move(loan.handle())); }
  /// Publishes a copy, made in the shared heap, of a message of this type that the caller keeps.
  /// See Publisher::publish(const T&), but a message of another process is not checked.
  PublishResult publish_copy_of(const void* message) noexcept {
    return publish_copy_of(message, std::chrono::milliseconds(0));
  }
  /// The same, and tries again for `timeout` while the result is would_block: it copies once.
  template <class Rep, class Period>
  PublishResult publish_copy_of(const void* message,
                                std::chrono::duration<Rep, Period> timeout) noexcept {
    detail::Timeout limit(timeout);
    auto copy = this->copy_in(*static_cast<const std::byte*>(message));
    for (;;) {
      // publish_copy() keeps it unless it succeeds.
      // NOLINTNEXTLINE(bugprone-use-after-move)
      const PublishResult result = this->publish_copy(std::move(copy));
      if (result.code != Errc::would_block || !limit.wait()) return result;
    }
  }
  const MessageMembers& members() const noexcept { return *members_; }

 private:
  const MessageMembers* members_;
};

/// Subscription and PollingSubscriber in one. Any thread may call any function.
class GenericSubscription : public SubscriptionBase {
 public:
  using SharedPtr = std::shared_ptr<GenericSubscription>;

  /// For create_generic_subscription.
  GenericSubscription(std::shared_ptr<detail::UntypedSubscription> untyped,
                      const MessageMembers* members) noexcept
      : SubscriptionBase(std::move(untyped)), members_(members) {}

  /// Takes the oldest unread message, or returns an empty one. Not for a subscription with a
  /// callback.
  GenericMessage take() noexcept {
    return {ipc_shared_ptr<const std::byte>(untyped().take()), members_};
  }
  /// See Subscription::take_batch.
  std::size_t take_batch(GenericMessage* messages, std::size_t count) noexcept {
    for (std::size_t i = 0; i < count; ++i) messages[i] = {};
    return detail::hand_out(untyped().take(count), [&](std::size_t i, detail::Block* block) {
      messages[i] = {ipc_shared_ptr<const std::byte>(block), members_};
    });
  }
  /// Null if it was created for a TypeIdentity alone.
  const MessageMembers* members() const noexcept { return members_; }

 private:
  const MessageMembers* members_;
};

AGNOCAST_CORE_END

using GenericCallback = std::function<void(GenericMessage)>;

namespace detail {

template <class Node>
Result<core::GenericSubscription::SharedPtr> make_generic_subscription(
    Node& node, const std::string& topic, const Result<MessageType>& type,
    const MessageMembers* members, const QoS& qos, GenericCallback callback,
    const SubscriptionOptionsOf<Node>& options) {
  if (!type) return tl::unexpected<Failure>(type.error());
  const Result<EndpointName> name = resolve(dereference(node), topic);
  if (!name) return tl::unexpected<Failure>(name.error());
  UntypedSubscription::Callback untyped_callback;
  if (callback) {
    untyped_callback = [function = std::move(callback), members](Block* block) {
      function(GenericMessage(ipc_shared_ptr<const std::byte>(block), members));
    };
  }
  QoS used = qos;
  const Result<core::SubscriptionOptions> adapted =
      AdapterOf<Node>::options(dereference(node), *name, used, options);
  if (!adapted) return tl::unexpected<Failure>(adapted.error());
  auto untyped =
      UntypedSubscription::create(*name, *type, used, *adapted, std::move(untyped_callback));
  if (!untyped) return tl::unexpected<Failure>(untyped.error());
  return std::make_shared<core::GenericSubscription>(std::move(*untyped), members);
}

}  // namespace detail

AGNOCAST_CORE_BEGIN

/// Creates a publisher of a type found at run time. Errors as of try_create_publisher.
template <class Node>
[[nodiscard]] Result<GenericPublisher::SharedPtr> try_create_generic_publisher(
    Node&& node, const std::string& topic, const IntrospectedType& type, const QoS& qos,
    const detail::PublisherOptionsOf<Node>& options = {}) {
  Result<detail::EndpointName> name = detail::resolve(detail::dereference(node), topic);
  if (!name) return tl::unexpected<Failure>(name.error());
  Result<MessageType> message_type = type.message_type();
  if (!message_type) return tl::unexpected<Failure>(message_type.error());
  const detail::MessageCode code{detail::EndByTable::of(type.members()), false};
  QoS used = qos;
  const Result<PublisherOptions> adapted =
      detail::AdapterOf<Node>::options(detail::dereference(node), *name, used, options);
  if (!adapted) return tl::unexpected<Failure>(adapted.error());
  auto untyped =
      detail::UntypedPublisher::create(*name, std::move(*message_type), used, *adapted, code);
  if (!untyped) return tl::unexpected<Failure>(untyped.error());
  return std::make_shared<GenericPublisher>(std::move(*untyped), type.members());
}
/// Finds the type by its name; errors also those of try_find_message_type.
template <class Node>
[[nodiscard]] Result<GenericPublisher::SharedPtr> try_create_generic_publisher(
    Node&& node, const std::string& topic, const std::string& type, const QoS& qos,
    const detail::PublisherOptionsOf<Node>& options = {}) {
  const auto found = try_find_message_type(type);
  if (!found) return tl::unexpected<Failure>(found.error());
  return try_create_generic_publisher(node, topic, *found, qos, options);
}

/// Creates a subscription to a type found at run time. The callback is called as that of
/// try_create_subscription; without one, use take().
template <class Node>
[[nodiscard]] Result<GenericSubscription::SharedPtr> try_create_generic_subscription(
    Node&& node, const std::string& topic, const IntrospectedType& type, const QoS& qos,
    GenericCallback callback = nullptr, const detail::SubscriptionOptionsOf<Node>& options = {}) {
  return detail::make_generic_subscription(node, topic, type.message_type(), &type.members(), qos,
                                           std::move(callback), options);
}
/// Finds the type by its name; errors also those of try_find_message_type.
template <class Node>
[[nodiscard]] Result<GenericSubscription::SharedPtr> try_create_generic_subscription(
    Node&& node, const std::string& topic, const std::string& type, const QoS& qos,
    GenericCallback callback = nullptr, const detail::SubscriptionOptionsOf<Node>& options = {}) {
  const auto found = try_find_message_type(type);
  if (!found) return tl::unexpected<Failure>(found.error());
  return try_create_generic_subscription(node, topic, *found, qos, std::move(callback), options);
}
/// Subscribes to messages of a type without a table: only their address and their size
/// (MessageInfo) are known. `identity` is what agnocast-ctl topic info --json prints for the
/// topic.
template <class Node>
[[nodiscard]] Result<GenericSubscription::SharedPtr> try_create_generic_subscription(
    Node&& node, const std::string& topic, const TypeIdentity& identity, const QoS& qos,
    GenericCallback callback = nullptr, const detail::SubscriptionOptionsOf<Node>& options = {}) {
  return detail::make_generic_subscription(node, topic, detail::make_named_type(identity), nullptr,
                                           qos, std::move(callback), options);
}

/// The same; these throw Error. `type`: a name, an IntrospectedType, and for subscriptions a
/// TypeIdentity.
template <class Node, class Type>
GenericPublisher::SharedPtr create_generic_publisher(
    Node&& node, const std::string& topic, const Type& type, const QoS& qos,
    const detail::PublisherOptionsOf<Node>& options = {}) {
  auto publisher = try_create_generic_publisher(node, topic, type, qos, options);
  if (!publisher) detail::throw_error(publisher.error());
  return std::move(*publisher);
}
template <class Node, class Type>
GenericSubscription::SharedPtr create_generic_subscription(
    Node&& node, const std::string& topic, const Type& type, const QoS& qos,
    GenericCallback callback = nullptr, const detail::SubscriptionOptionsOf<Node>& options = {}) {
  auto subscription =
      try_create_generic_subscription(node, topic, type, qos, std::move(callback), options);
  if (!subscription) detail::throw_error(subscription.error());
  return std::move(*subscription);
}

AGNOCAST_CORE_END

}  // namespace agnocast
