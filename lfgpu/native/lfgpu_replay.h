// Disparity maps without Python: a library that runs what `lfgpu export` wrote.
//
//     lfgpu::Replay replay("pipeline", 8);                     // the folder; threads of a CPU
//     std::vector<float> disparity(replay.pixels()), confidence(replay.pixels());
//     while (next_frame(views))                                // [n, y, x, c] as stored, replay.frame_bytes() bytes
//         replay.solve(views, disparity.data(), confidence.data());
//
// Each frame starts from the map before, as in `lfgpu.DepthStream`, and the maps have the same bits. One thread at a
// time may use a Replay; several threads may use one each.
#ifndef LFGPU_REPLAY_H
#define LFGPU_REPLAY_H

#include <cstddef>
#include <memory>
#include <stdexcept>
#include <string>

namespace lfgpu {

// What is wrong, in one sentence.
struct Error : std::runtime_error {
    using std::runtime_error::runtime_error;
};

class Replay {
public:
    // Load a folder that `lfgpu export` wrote. Work on a CPU is done by so many threads; 0: one for each core.
    explicit Replay(const std::string& folder, unsigned threads = 0);
    ~Replay();
    Replay(const Replay&) = delete;
    Replay& operator=(const Replay&) = delete;

    std::size_t frame_bytes() const; // of the views [n, y, x, c] of a frame
    std::size_t height() const;
    std::size_t width() const;
    std::size_t pixels() const { return height() * width(); }

    // Estimate a frame. Both maps are float32 [y, x]: disparity in pixels per view step, NaN where it is unknown, and
    // confidence from 0 to 1; either may be null. Returns whether the frame started without the map before: the first
    // one, one after a scene cut, one after `restart`, or all if the folder was exported with --cold.
    bool solve(const void* views, float* disparity, float* confidence);

    // Forget the map before.
    void restart();

private:
    struct Parts;
    std::unique_ptr<Parts> parts_;
};

} // namespace lfgpu

#endif
