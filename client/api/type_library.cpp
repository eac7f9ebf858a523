// SPDX-License-Identifier: Apache-2.0
//
// Type libraries: finds the function of a package's introspection library for the ROS name of a
// message type. Only the user's translation unit can read the result of that function
// (generic.hpp).
//
//     "pkg/msg/Name" → validated parts → directory/libpkg__rosidl_typesupport_introspection_cpp.so
//                                      → …get_message_type_support_handle__pkg__msg__Name
//
// The name may come from a command line or from another process, so only letters, digits and
// underscores become part of a path or a symbol. Libraries stay loaded, because messages are
// destroyed by their code at any later time. A failure is not kept: the next call searches again.

#include <agnocast/type_library.hpp>
#include <client/api/message_plan.hpp>
#include <client/process/forked_child.hpp>

#include <dlfcn.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <map>
#include <memory>
#include <mutex>
#include <new>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace agnocast::detail {
namespace {

// Limit of each part of a name; file names have 255 bytes.
constexpr std::size_t part_bytes_max = 200;
// Limits for needed libraries that are only in our directories.
constexpr std::size_t needed_depth_max = 32;
constexpr std::size_t needed_count_max = 256;

struct TypeName {
  std::string package, kind, name;
  std::string text() const { return package + '/' + kind + '/' + name; }
};

bool is_identifier(std::string_view text) noexcept {
  const auto is_letter = [](char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z'); };
  if (text.empty() || text.size() > part_bytes_max || !is_letter(text.front())) return false;
  return std::all_of(text.begin(), text.end(),
                     [&](char c) { return is_letter(c) || (c >= '0' && c <= '9') || c == '_'; });
}

Result<TypeName> parse(std::string_view text) {
  const std::size_t first = text.find('/'), last = text.rfind('/');
  TypeName type;
  if (first != text.npos) {
    type.package = text.substr(0, first);
    type.kind = first == last ? "msg" : text.substr(first + 1, last - first - 1);
    type.name = text.substr(last + 1);
  }
  const bool is_kind = type.kind == "msg" || type.kind == "srv" || type.kind == "action";
  if (is_kind && is_identifier(type.package) && is_identifier(type.name)) return type;
  // Shows only characters that are safe in a terminal.
  std::string shown;
  for (const char c : text.substr(0, 100)) shown += c > ' ' && c < '\x7f' ? c : '?';
  return fail_with(Errc::invalid_name,
                   "'" + shown + "' is no message type; one is like sensor_msgs/msg/PointCloud2");
}

class Loader {
 public:
  explicit Loader(const std::vector<std::string>& paths) : directories_(paths) {
    const char* const prefixes = ::secure_getenv("AMENT_PREFIX_PATH");
    std::string_view rest = prefixes != nullptr ? prefixes : "";
    while (!rest.empty()) {
      const std::string_view prefix = rest.substr(0, rest.find(':'));
      if (!prefix.empty()) directories_.push_back(std::string(prefix) + "/lib");
      rest.remove_prefix(std::min(rest.size(), prefix.size() + 1));
    }
  }

  /// Returns the library, or null; then why(file) has the reason.
  void* load(const std::string& file, std::size_t depth = 0) {
    const std::string path = path_of(file);
    for (;;) {
      if (void* const library = ::dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE))
        return library;
      const char* const why = ::dlerror();
      error_ = why != nullptr ? why : "dlopen";
      // A needed library is missing: load it from our directories first, then try again.
      const std::string missing = error_.substr(0, error_.find(": cannot open shared object"));
      if (missing.size() == error_.size() || missing == path) return nullptr;
      if (missing.find('/') != missing.npos || path_of(missing) == missing) return nullptr;
      if (depth == needed_depth_max || ++needed_count_ > needed_count_max) return nullptr;
      if (load(missing, depth + 1) == nullptr) return nullptr;
    }
  }
  /// Returns why load(file) returned null.
  std::string why(const std::string& file) const {
    // The loader may have found it as well, and refused it or a library that it needs.
    const std::string absent = file + ": cannot open shared object file: No such file";
    if (error_.compare(0, absent.size(), absent) != 0) return error_;
    std::string text = "no " + file;
    if (directories_.empty()) return text + " where the loader searches";
    text += " in ";
    for (const std::string& directory : directories_) text += directory + ", ";
    return text + "nor where the loader searches";
  }

 private:
  // Returns the first existing path; else the file's name, for the loader to search.
  std::string path_of(const std::string& file) const {
    for (const std::string& directory : directories_) {
      std::string path = directory + '/' + file;
      if (::access(path.c_str(), F_OK) == 0) return path;
    }
    return file;
  }

  std::vector<std::string> directories_;
  std::string error_;
  std::size_t needed_count_ = 0;
};

// Libraries by package. Never destroyed: threads may create endpoints while exit handlers run.
struct Loaded {
  std::mutex mutex;
  std::map<std::string, void*> libraries;

  static Loaded& instance() {
    static Loaded* const all = new Loaded;
    return *all;
  }
  void* find(const std::string& package) {
    const std::lock_guard lock(mutex);
    const auto found = libraries.find(package);
    return found != libraries.end() ? found->second : nullptr;
  }
  // Two threads may have loaded it at the same time; it is the same library.
  void add(const std::string& package, void* library) {
    const std::lock_guard lock(mutex);
    libraries.emplace(package, library);
  }
};

Result<void*> library_of(const TypeName& type, const std::string& file,
                         const std::vector<std::string>& paths) {
  if (void* const known = Loaded::instance().find(type.package)) return known;
  Loader loader(paths);
  void* const library = loader.load(file);
  if (library == nullptr)
    return fail_with(Errc::type_not_found, type.text() + ": " + loader.why(file));
  Loaded::instance().add(type.package, library);
  return library;
}

// Converts bad_alloc, the only exception in here.
template <class Do>
auto without_throwing(Do&& work) noexcept -> decltype(work()) {
  try {
    return work();
  } catch (const std::bad_alloc&) {
    return fail(Errc::os_failure, "finding a message type", ENOMEM);
  }
}

}  // namespace

Result<void*> find_type_support(const std::string& name,
                                const std::vector<std::string>& paths) noexcept {
  return without_throwing([&]() -> Result<void*> {
    if (Result<void> own = refuse_forked_child(); !own) return tl::unexpected<Failure>(own.error());
    const Result<TypeName> type = parse(name);
    if (!type) return tl::unexpected<Failure>(type.error());
    const std::string support = "rosidl_typesupport_introspection_cpp";
    const std::string file = "lib" + type->package + "__" + support + ".so";
    const Result<void*> library = library_of(*type, file, paths);
    if (!library) return library;
    const std::string symbol = support + "__get_message_type_support_handle__" + type->package +
                               "__" + type->kind + "__" + type->name;
    void* const function = ::dlsym(*library, symbol.c_str());
    if (function != nullptr) return function;
    return fail_with(Errc::type_not_found, type->text() + ": " + file + " has no such type");
  });
}

Result<MessageType> make_named_type(const TypeIdentity& identity) noexcept {
  return without_throwing([&]() -> Result<MessageType> {
    std::unique_ptr<MessagePlan, DestroyPlan> plan(new MessagePlan);
    plan->name = identity.name;
    plan->layout_hash = identity.layout_hash;
    plan->alignment = 1;
    return MessageType(std::move(plan));
  });
}

}  // namespace agnocast::detail
