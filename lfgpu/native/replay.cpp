// Disparity maps without Python: replays what `lfgpu export` wrote, by the C interface of Warp's own libraries.
//
//     replay FOLDER FRAMES MAPS [REPEATS]
//
// FOLDER is what `lfgpu export` made. FRAMES holds frames one after the other, each the views [n, y, x, c] as they are
// stored, without any header. MAPS gets for each frame its disparity [y, x] and then its confidence [y, x], float32 in
// the byte order of the machine, without a header. With REPEATS each frame is solved as often, to be timed.
//
// It must be linked with the very version of Warp that wrote FOLDER: README.txt there says how. One process may hold
// several pipelines, but each belongs to one thread at a time.

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <map>
#include <string>
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

[[noreturn]] static void fail(const std::string& sentence)
{
    std::fprintf(stderr, "replay: %s\n", sentence.c_str());
    std::exit(1);
}

static std::string line_of(const std::string& path)
{
    std::ifstream file(path);
    std::string line;
    if (!std::getline(file, line)) fail(path + " cannot be read; give a folder that lfgpu export made.");
    return line;
}

class Pipeline {
public:
    explicit Pipeline(const std::string& folder) : on_gpu_(line_of(folder + "/device.txt") != "cpu")
    {
        const std::string version = line_of(folder + "/warp-version.txt"), path = folder + "/pipeline.wrp";
        if (wp_init(version.c_str()) != 0) fail(std::string("Warp does not start: ") + wp_get_error_string());
        if (on_gpu_) {
            context_ = wp_cuda_device_get_primary_context(0);
            wp_cuda_context_set_current(context_);
            stream_ = wp_cuda_stream_create(context_, 0);
        } else if (!wp_llvm_set_cpu_block_runtime(wp_cpu_block_runtime_get_api())) {
            fail("Warp's compiler library is of another version than its runtime.");
        }
        graph_ = wp_apic_load_graph(context_, path.c_str(), on_gpu_ ? 0 : 1);
        if (!graph_) fail(path + " cannot be loaded: " + wp_get_error_string());
        if (!on_gpu_) load_kernels(folder + "/pipeline_modules/");
    }
    ~Pipeline() { wp_apic_destroy_graph(graph_); }
    Pipeline(const Pipeline&) = delete;
    Pipeline& operator=(const Pipeline&) = delete;

    // Bytes of "views", "disparity" or "confidence".
    size_t size(const char* name) const { return wp_apic_get_param_size(graph_, name); }

    void solve(const std::vector<char>& views)
    {
        if (!wp_apic_set_param(graph_, "views", views.data(), views.size())) fail("views are not taken.");
        if (!(on_gpu_ ? wp_apic_launch(graph_, stream_) : wp_apic_cpu_replay_graph(graph_))) fail("it does not run.");
        if (on_gpu_) wp_cuda_context_synchronize(context_);
    }

    void read(const char* name, std::vector<char>& map) const
    {
        map.resize(size(name));
        if (!wp_apic_get_param(graph_, name, map.data(), map.size())) fail(std::string(name) + " is not given.");
    }

private:
    void load_kernels(const std::string& folder)
    {
        std::map<std::string, bool> loaded;
        for (int i = 0; i < wp_apic_get_num_kernels(graph_); ++i) {
            const char* const forward = wp_apic_get_kernel_forward_name(graph_, i);
            if (!forward || !*forward) continue;
            const std::string module = wp_apic_get_kernel_module_binary_filename(graph_, i);
            if (!loaded[module] && wp_load_obj((folder + module).c_str(), module.c_str(), false) != 0)
                fail(folder + module + " cannot be loaded.");
            loaded[module] = true;
            void* const function = reinterpret_cast<void*>(wp_lookup(module.c_str(), forward));
            if (!function) fail(folder + module + " lacks " + forward + ".");
            wp_apic_register_loaded_cpu_kernel(
                graph_, wp_apic_get_kernel_key(graph_, i), wp_apic_get_kernel_module_hash(graph_, i), function, nullptr
            );
        }
    }

    bool on_gpu_;
    void *context_ = nullptr, *stream_ = nullptr;
    APICGraph* graph_ = nullptr;
};

int main(int count, char** arguments)
{
    if (count != 4 && count != 5) fail("usage: replay FOLDER FRAMES MAPS [REPEATS]");
    const int repeats = count == 5 ? std::atoi(arguments[4]) : 1;
    if (repeats < 1) fail("REPEATS must be a whole number from 1 on.");
    Pipeline pipeline(arguments[1]);
    std::ifstream frames(arguments[2], std::ios::binary);
    if (!frames) fail(std::string(arguments[2]) + " cannot be read.");
    std::ofstream maps(arguments[3], std::ios::binary);

    std::vector<char> views(pipeline.size("views")), map;
    double best = 1e30, total = 0;
    long number = 0;
    while (frames.read(views.data(), static_cast<std::streamsize>(views.size()))) {
        for (int i = 0; i < repeats; ++i) {
            const auto start = std::chrono::steady_clock::now();
            pipeline.solve(views);
            const std::chrono::duration<double, std::milli> took = std::chrono::steady_clock::now() - start;
            best = took.count() < best ? took.count() : best;
            total += took.count();
        }
        for (const char* name : {"disparity", "confidence"}) {
            pipeline.read(name, map);
            maps.write(map.data(), static_cast<std::streamsize>(map.size()));
        }
        ++number;
    }
    if (frames.gcount() != 0) fail(std::string(arguments[2]) + " ends in the middle of a frame.");
    if (!maps.flush()) fail(std::string(arguments[3]) + " cannot be written.");
    if (number > 0)
        std::fprintf(stderr, "%ld frames, %.2f ms each, at best %.2f ms\n", number, total / (number * repeats), best);
    return 0;
}
