// Disparity maps without Python: runs what `lfgpu export` wrote on frames from a file.
//
//     replay FOLDER FRAMES MAPS [--threads N] [--repeat N]
//
// FRAMES holds frames one after the other, each the views [n, y, x, c] as they are stored, without any header. MAPS gets
// for each frame its disparity [y, x] and then its confidence [y, x], float32 in the byte order of the machine, without
// a header. With --repeat the frames are estimated so many times over, to be timed.

#include "lfgpu_replay.h"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <string>
#include <vector>

static int run(int count, char** arguments)
{
    std::vector<std::string> given;
    long threads = 0, repeats = 1;
    for (int k = 1; k < count; ++k) {
        const std::string word = arguments[k];
        if (word == "--threads" || word == "--repeat") {
            const long number = k + 1 < count ? std::atol(arguments[++k]) : 0;
            if (number < 1 || number > 4096) throw lfgpu::Error(word + " must be a whole number from 1 on.");
            (word == "--threads" ? threads : repeats) = number;
        } else {
            given.push_back(word);
        }
    }
    if (given.size() != 3) throw lfgpu::Error("usage: replay FOLDER FRAMES MAPS [--threads N] [--repeat N]");
    lfgpu::Replay replay(given[0], static_cast<unsigned>(threads));
    std::ofstream maps(given[2], std::ios::binary);
    std::vector<char> views(replay.frame_bytes());
    std::vector<float> disparity(replay.pixels()), confidence(replay.pixels());
    std::vector<double> times;
    long cold = 0;
    for (long round = 0; round < repeats; ++round) {
        std::ifstream frames(given[1], std::ios::binary);
        if (!frames) throw lfgpu::Error(given[1] + " cannot be read.");
        while (frames.read(views.data(), static_cast<std::streamsize>(views.size()))) {
            const auto start = std::chrono::steady_clock::now();
            cold += replay.solve(views.data(), disparity.data(), confidence.data());
            const std::chrono::duration<double, std::milli> took = std::chrono::steady_clock::now() - start;
            times.push_back(took.count());
            for (const std::vector<float>* map : {&disparity, &confidence})
                if (round == 0)
                    maps.write(
                        reinterpret_cast<const char*>(map->data()),
                        static_cast<std::streamsize>(map->size() * sizeof(float))
                    );
        }
        if (frames.gcount() != 0) throw lfgpu::Error(given[1] + " ends in the middle of a frame.");
    }
    if (!maps.flush()) throw lfgpu::Error(given[2] + " cannot be written.");
    if (!times.empty()) {
        std::sort(times.begin(), times.end());
        std::fprintf(
            stderr, "%zu frames, %ld without the map before; %.2f ms each in the median, %.2f ms for 99 %%\n",
            times.size(), cold, times[times.size() / 2], times[times.size() * 99 / 100]
        );
    }
    return 0;
}

int main(int count, char** arguments)
{
    try {
        return run(count, arguments);
    } catch (const std::exception& error) {
        std::fprintf(stderr, "replay: %s\n", error.what());
        return 1;
    }
}
