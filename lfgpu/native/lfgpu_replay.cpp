// How a recorded pipeline runs: Warp's own libraries replay it, by their C interface. On a CPU they call each kernel on
// one thread. Here they are given functions of ours in place of the kernels. lfgpu recorded a mark before each slice of
// work that was cut into independent slices, and another one after the last. From the first mark on these functions only
// note the calls; at the last one the slices run side by side, the calls of each in their order.

#include "lfgpu_replay.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <condition_variable>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <map>
#include <mutex>
#include <sstream>
#include <thread>
#include <utility>
#include <vector>

// Of native/warp.h, native/apic.h, native/cpu_block_runtime.h and native/warp_clang.h in Warp's package, as far as they
// are needed here.
struct APICGraph;
extern "C" {
int wp_init(const char* expected_version);
const char* wp_get_error_string();
void* wp_cuda_device_get_primary_context(int ordinal);
void wp_cuda_context_set_current(void* context);
bool wp_cuda_context_synchronize(void* context);
void* wp_cuda_stream_create(void* context, int priority);
APICGraph* wp_apic_load_graph(void* context, const char* path, int device_type);
void wp_apic_destroy_graph(APICGraph* graph);
bool wp_apic_set_param(APICGraph* graph, const char* name, const void* data, size_t size);
bool wp_apic_get_param(APICGraph* graph, const char* name, void* data, size_t size);
size_t wp_apic_get_param_size(APICGraph* graph, const char* name);
bool wp_apic_launch(APICGraph* graph, void* stream);
bool wp_apic_cpu_replay_graph(APICGraph* graph);
void wp_apic_register_loaded_cpu_kernel(
    APICGraph* graph, const char* kernel_key, const char* module_hash, void* forward, void* backward
);
int wp_apic_get_num_kernels(APICGraph* graph);
const char* wp_apic_get_kernel_key(APICGraph* graph, int index);
const char* wp_apic_get_kernel_module_hash(APICGraph* graph, int index);
const char* wp_apic_get_kernel_module_binary_filename(APICGraph* graph, int index);
const char* wp_apic_get_kernel_forward_name(APICGraph* graph, int index);
struct wp_cpu_block_runtime_api;
const wp_cpu_block_runtime_api* wp_cpu_block_runtime_get_api();
int wp_llvm_set_cpu_block_runtime(const wp_cpu_block_runtime_api* api);
int wp_load_obj(const char* object_file, const char* module_name, bool use_legacy_linker);
uint64_t wp_lookup(const char* module_name, const char* function_name);
}

namespace lfgpu {
namespace {

using Kernel = void (*)(void* bounds, void* arguments);

constexpr std::size_t most_kernels = 512; // that all folders of a process have together
constexpr std::size_t bounds_bytes = 32;  // of a launch in up to 4 dimensions

// Threads that run calls side by side, the calling one among them.
class Team {
public:
    explicit Team(unsigned threads)
    {
        for (unsigned k = 1; k < threads; ++k) others_.emplace_back([this] { help(); });
    }
    ~Team()
    {
        {
            const std::lock_guard<std::mutex> guard(lock_);
            ends_ = true;
        }
        begun_.notify_all();
        for (std::thread& other : others_) other.join();
    }
    Team(const Team&) = delete;
    Team& operator=(const Team&) = delete;

    // The calls that follow are a slice.
    void open()
    {
        is_open_ = true;
        slices_.push_back(calls_.size());
    }
    bool is_open() const { return is_open_; }

    // Note a call of a kernel; what its arguments say is copied.
    void note(Kernel kernel, const void* bounds, const void* arguments, std::size_t bytes)
    {
        const std::size_t at = blob_.size();
        blob_.resize(at + bounds_bytes + (bytes + 15) / 16 * 16);
        std::memcpy(&blob_[at], bounds, bounds_bytes);
        if (bytes > 0) std::memcpy(&blob_[at + bounds_bytes], arguments, bytes);
        calls_.emplace_back(kernel, at);
    }

    // Run all slices, and wait for them.
    void close()
    {
        is_open_ = false;
        if (!others_.empty() && slices_.size() > 1) {
            {
                const std::lock_guard<std::mutex> guard(lock_);
                next_ = 0;
                working_ = static_cast<unsigned>(others_.size());
                ++round_;
            }
            begun_.notify_all();
            work();
            std::unique_lock<std::mutex> guard(lock_);
            done_.wait(guard, [this] { return working_ == 0; });
        } else {
            next_ = 0;
            work();
        }
        slices_.clear();
        calls_.clear();
        blob_.clear();
    }

private:
    void work()
    {
        for (std::size_t k; (k = next_.fetch_add(1)) < slices_.size();) {
            const std::size_t end = k + 1 < slices_.size() ? slices_[k + 1] : calls_.size();
            for (std::size_t call = slices_[k]; call < end; ++call)
                calls_[call].first(&blob_[calls_[call].second], &blob_[calls_[call].second + bounds_bytes]);
        }
    }
    void help()
    {
        for (unsigned long seen = 0;;) {
            {
                std::unique_lock<std::mutex> guard(lock_);
                begun_.wait(guard, [&] { return ends_ || round_ != seen; });
                if (ends_) return;
                seen = round_;
            }
            work();
            const std::lock_guard<std::mutex> guard(lock_);
            if (--working_ == 0) done_.notify_one();
        }
    }

    std::vector<std::size_t> slices_; // the first call of each
    std::vector<std::pair<Kernel, std::size_t>> calls_;
    std::vector<unsigned char> blob_;
    std::vector<std::thread> others_;
    std::mutex lock_;
    std::condition_variable begun_, done_;
    std::atomic<std::size_t> next_{0};
    unsigned working_ = 0;
    unsigned long round_ = 0;
    bool ends_ = false, is_open_ = false;
};

// A kernel of Warp, or a mark.
struct Known {
    enum Kind { work, begin, end } kind = work;
    Kernel kernel = nullptr;
    std::size_t bytes = 0; // of its arguments
};

std::array<Known, most_kernels> known;
std::size_t known_count = 0;
std::map<std::string, std::size_t> places; // of kernels in `known`, by module and name
std::mutex loading;
thread_local Team* team = nullptr; // that works for this thread

// What is called in place of the kernel `known[place]`.
template <std::size_t place> void instead(void* bounds, void* arguments)
{
    const Known& its = known[place];
    if (its.kind == Known::begin)
        team->open();
    else if (its.kind == Known::end)
        team->close();
    else if (team->is_open())
        team->note(its.kernel, bounds, arguments, its.bytes);
    else
        its.kernel(bounds, arguments);
}

template <std::size_t... place> constexpr std::array<Kernel, most_kernels> all_of(std::index_sequence<place...>)
{
    return {instead<place>...};
}
constexpr std::array<Kernel, most_kernels> replacements = all_of(std::make_index_sequence<most_kernels>());

// replay.txt: lines of a name and values.
class Description {
public:
    explicit Description(const std::string& folder) : path_(folder + "/replay.txt")
    {
        std::ifstream file(path_);
        if (!file) throw Error(path_ + " cannot be read; give a folder that lfgpu export made.");
        for (std::string line; std::getline(file, line);) {
            std::istringstream words(line);
            std::string name;
            words >> name;
            std::vector<std::string> values;
            for (std::string value; words >> value;) values.push_back(value);
            lines_.emplace(name, values);
        }
    }
    std::vector<std::string> words(const std::string& name) const
    {
        const auto found = lines_.find(name);
        if (found == lines_.end()) throw Error(path_ + " lacks " + name + "; export the folder again.");
        return found->second;
    }
    std::string word(const std::string& name) const
    {
        const std::vector<std::string> found = words(name);
        if (found.size() != 1) throw Error(path_ + " is damaged: " + name + " must have one value.");
        return found[0];
    }
    std::vector<double> numbers(const std::string& name, std::size_t count = 0) const
    {
        std::vector<double> found;
        try {
            for (const std::string& word : words(name)) found.push_back(std::stod(word));
        } catch (const std::logic_error&) {
            throw Error(path_ + " is damaged: " + name + " must be numbers.");
        }
        if (count > 0 && found.size() != count) throw Error(path_ + " is damaged: " + name + " has too few numbers.");
        return found;
    }
    auto kernels() const { return lines_.equal_range("kernel"); }

private:
    std::string path_;
    std::multimap<std::string, std::vector<std::string>> lines_;
};

// One recorded piece of work with its own memory.
class Graph {
public:
    Graph(const std::string& folder, const std::string& name, void* context, bool on_gpu, const Description& about)
        : on_gpu_(on_gpu), context_(context)
    {
        const std::string path = folder + "/" + name + ".wrp";
        graph_ = wp_apic_load_graph(context, path.c_str(), on_gpu ? 0 : 1);
        if (graph_ == nullptr) throw Error(path + " cannot be loaded: " + wp_get_error_string());
        try {
            if (on_gpu)
                stream_ = wp_cuda_stream_create(context, 0);
            else
                load_kernels(folder + "/" + name + "_modules/", about);
        } catch (...) {
            wp_apic_destroy_graph(graph_);
            throw;
        }
    }
    ~Graph() { wp_apic_destroy_graph(graph_); }
    Graph(const Graph&) = delete;
    Graph& operator=(const Graph&) = delete;

    std::size_t size(const std::string& name) const { return wp_apic_get_param_size(graph_, name.c_str()); }
    void set(const std::string& name, const void* data, std::size_t bytes)
    {
        if (!wp_apic_set_param(graph_, name.c_str(), data, bytes)) throw Error(name + " cannot be set.");
    }
    void get(const std::string& name, void* data, std::size_t bytes) const
    {
        if (!wp_apic_get_param(graph_, name.c_str(), data, bytes)) throw Error(name + " cannot be read.");
    }
    void run()
    {
        if (!(on_gpu_ ? wp_apic_launch(graph_, stream_) : wp_apic_cpu_replay_graph(graph_)))
            throw Error(std::string("the recorded work fails: ") + wp_get_error_string());
        if (on_gpu_) wp_cuda_context_synchronize(context_);
    }

private:
    void load_kernels(const std::string& folder, const Description& about)
    {
        const std::lock_guard<std::mutex> guard(loading);
        std::map<std::string, std::vector<std::string>> told; // by module and name: bytes of arguments, kind
        const auto [first, last] = about.kernels();
        for (auto line = first; line != last; ++line)
            if (line->second.size() == 4) told[line->second[0] + " " + line->second[1]] = line->second;
        for (int i = 0; i < wp_apic_get_num_kernels(graph_); ++i) {
            const char* const forward = wp_apic_get_kernel_forward_name(graph_, i);
            if (forward == nullptr || *forward == 0) continue;
            const std::string module = wp_apic_get_kernel_module_binary_filename(graph_, i);
            const std::string name = module + " " + forward;
            if (places.find(name) == places.end()) {
                const auto found = told.find(name);
                if (found == told.end()) throw Error(folder + module + ": " + forward + " is not in replay.txt.");
                if (known_count == most_kernels) throw Error("too many kernels in one process; replay fewer folders.");
                static std::map<std::string, bool> loaded;
                if (!loaded[module] && wp_load_obj((folder + module).c_str(), module.c_str(), false) != 0)
                    throw Error(folder + module + " cannot be loaded.");
                loaded[module] = true;
                Known& its = known[known_count];
                its.kernel = reinterpret_cast<Kernel>(wp_lookup(module.c_str(), forward));
                if (its.kernel == nullptr) throw Error(folder + module + " lacks " + forward + ".");
                its.bytes = std::stoul(found->second[2]);
                const std::string& kind = found->second[3];
                its.kind = kind == "begin" ? Known::begin : kind == "end" ? Known::end : Known::work;
                places[name] = known_count++;
            }
            wp_apic_register_loaded_cpu_kernel(
                graph_, wp_apic_get_kernel_key(graph_, i), wp_apic_get_kernel_module_hash(graph_, i),
                reinterpret_cast<void*>(replacements[places[name]]), nullptr
            );
        }
    }

    bool on_gpu_;
    void *context_, *stream_ = nullptr;
    APICGraph* graph_ = nullptr;
};

// How much the reference view changed: of some samples, the share whose mean change over the channels is large.
class Change {
public:
    Change(const Description& about, const std::vector<double>& shape)
        : height_(std::size_t(shape[1])), width_(std::size_t(shape[2])), channels_(std::size_t(shape[3])),
          type_(about.word("type")), scale_(float(about.numbers("scale", 1)[0])),
          tolerance_(float(about.numbers("tolerance", 1)[0]))
    {
        stride_y_ = std::max<std::size_t>(1, height_ / samples);
        stride_x_ = std::max<std::size_t>(1, width_ / samples);
    }

    // The share for a new reference view [y, x, c], which is then the last one.
    double look(const unsigned char* view)
    {
        const std::size_t rows = (height_ + stride_y_ - 1) / stride_y_, columns = (width_ + stride_x_ - 1) / stride_x_;
        last_.resize(rows * columns * channels_);
        std::size_t changed = 0;
        for (std::size_t j = 0; j < rows; ++j)
            for (std::size_t i = 0; i < columns; ++i) {
                const std::size_t y = j * stride_y_ + stride_y_ / 2, x = i * stride_x_ + stride_x_ / 2;
                if (y >= height_ || x >= width_) continue;
                float change = 0;
                for (std::size_t c = 0; c < channels_; ++c) {
                    const float now = value(view, (y * width_ + x) * channels_ + c);
                    float& before = last_[(j * columns + i) * channels_ + c];
                    change = change + std::fabs(now - before);
                    before = now;
                }
                if (!(change * scale_ <= tolerance_ * float(channels_))) ++changed;
            }
        return double(changed) / double(rows * columns);
    }

private:
    float value(const unsigned char* view, std::size_t k) const
    {
        if (type_ == "uint8") return float(view[k]);
        if (type_ == "uint16") {
            std::uint16_t number;
            std::memcpy(&number, view + 2 * k, 2);
            return float(number);
        }
        float number;
        std::memcpy(&number, view + 4 * k, 4);
        return number;
    }

    static constexpr std::size_t samples = 64; // along each side
    std::size_t height_, width_, channels_, stride_y_ = 1, stride_x_ = 1;
    std::string type_;
    float scale_, tolerance_;
    std::vector<float> last_;
};

} // namespace

struct Replay::Parts {
    Parts(const std::string& folder, unsigned threads)
        : about(folder), shape(about.numbers("views", 4)), on_gpu(about.word("device") != "cpu"),
          used(about.numbers("used")), state(about.words("state")), cut(about.numbers("cut", 1)[0]),
          change(about, shape), team(on_gpu ? 1 : threads > 0 ? threads : std::max(1u, std::thread::hardware_concurrency()))
    {
        const std::string version = about.word("warp");
        {
            const std::lock_guard<std::mutex> guard(loading);
            if (wp_init(version.c_str()) != 0) throw Error(std::string("Warp does not start: ") + wp_get_error_string());
            if (!on_gpu && wp_llvm_set_cpu_block_runtime(wp_cpu_block_runtime_get_api()) == 0)
                throw Error("Warp's compiler library is of another version than its runtime.");
        }
        void* context = nullptr;
        if (on_gpu) {
            context = wp_cuda_device_get_primary_context(0);
            wp_cuda_context_set_current(context);
        }
        cold = std::make_unique<Graph>(folder, "pipeline", context, on_gpu, about);
        if (!state.empty()) warm = std::make_unique<Graph>(folder, "warm", context, on_gpu, about);
        views.resize(cold->size("views"));
        view_bytes = views.size() / used.size();
    }

    Description about;
    std::vector<double> shape;
    bool on_gpu;
    std::vector<double> used; // indices of the views that are looked at
    std::vector<std::string> state; // what a frame leaves for the next one; empty if nothing
    double cut;
    Change change;
    Team team;
    std::unique_ptr<Graph> cold, warm;
    std::vector<unsigned char> views, moved;
    std::size_t view_bytes = 0;
    bool is_fresh = true; // whether there is no map before
    bool is_in_cold = true; // which graph has the state
};

Replay::Replay(const std::string& folder, unsigned threads) : parts_(std::make_unique<Parts>(folder, threads)) {}
Replay::~Replay() = default;

std::size_t Replay::frame_bytes() const { return std::size_t(parts_->shape[0]) * parts_->view_bytes; }
std::size_t Replay::height() const { return std::size_t(parts_->shape[1]); }
std::size_t Replay::width() const { return std::size_t(parts_->shape[2]); }

void Replay::restart() { parts_->is_fresh = true; }

bool Replay::solve(const void* views, float* disparity, float* confidence)
{
    Parts& p = *parts_;
    const auto* const bytes = static_cast<const unsigned char*>(views);
    for (std::size_t k = 0; k < p.used.size(); ++k)
        std::memcpy(&p.views[k * p.view_bytes], bytes + std::size_t(p.used[k]) * p.view_bytes, p.view_bytes);
    const std::size_t reference = std::size_t(p.about.numbers("reference", 1)[0]);
    const double changed = p.change.look(bytes + reference * p.view_bytes);
    const bool is_cold = p.is_fresh || !p.warm || changed > p.cut;
    Graph& graph = is_cold ? *p.cold : *p.warm;
    if (!is_cold && p.is_in_cold)
        for (const std::string& name : p.state) {
            p.moved.resize(p.cold->size(name));
            p.cold->get(name, p.moved.data(), p.moved.size());
            p.warm->set(name, p.moved.data(), p.moved.size());
        }
    graph.set("views", p.views.data(), p.views.size());
    p.is_fresh = true; // should it fail
    team = &p.team;
    graph.run();
    p.is_fresh = false;
    p.is_in_cold = is_cold;
    const std::size_t map = pixels() * sizeof(float);
    if (disparity != nullptr) graph.get("disparity", disparity, map);
    if (confidence != nullptr) graph.get("confidence", confidence, map);
    return is_cold;
}

} // namespace lfgpu
