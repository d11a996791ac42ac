// A producer of frames for `lfgpu live ring:FILE`, in C++: here of test pictures; yours come from cameras.
//
//     c++ -std=c++17 -O2 -Ilfgpu/native examples/ring_producer.cpp -o ring_producer
//     ./ring_producer /dev/shm/rig 3x3 480x640 600 60      # 600 frames, 60 a second; 0: as fast as possible
//     lfgpu live ring:/dev/shm/rig --disparity-range=-2,2  # at the same time

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <thread>
#include <vector>

#include "lfgpu_ring.h"

int main(int count, char** arguments)
{
    unsigned rows = 0, columns = 0, height = 0, width = 0;
    if (count != 6 || std::sscanf(arguments[2], "%ux%u", &rows, &columns) != 2
        || std::sscanf(arguments[3], "%ux%u", &height, &width) != 2) {
        std::fprintf(stderr, "usage: ring_producer FILE ROWSxCOLUMNS HEIGHTxWIDTH FRAMES RATE\n");
        return 2;
    }
    const long frames = std::atol(arguments[4]);
    const double rate = std::atof(arguments[5]);
    std::vector<double> positions; // (u, v): u to the right, v down, in view steps
    for (unsigned v = 0; v < rows; ++v)
        for (unsigned u = 0; u < columns; ++u) positions.insert(positions.end(), {double(u), double(v)});

    lfgpu_ring ring;
    const unsigned views = rows * columns;
    const lfgpu_ring_kind kind = {views, height, width, 3, LFGPU_RING_UINT8, views / 2, 4, positions.data()};
    if (lfgpu_ring_create(&ring, arguments[1], &kind) != 0) {
        std::fprintf(stderr, "ring_producer: %s cannot be made: %s\n", arguments[1], std::strerror(errno));
        return 1;
    }
    const auto start = std::chrono::steady_clock::now();
    for (long frame = 1; frame <= frames; ++frame) {
        if (rate > 0)
            std::this_thread::sleep_until(start + std::chrono::duration_cast<std::chrono::nanoseconds>(
                                              std::chrono::duration<double>(double(frame) / rate)));
        void* const pixels = lfgpu_ring_begin(&ring); // [n, y, x, c]: here all of one value
        std::memset(pixels, int(frame % 251), std::size_t(views) * height * width * 3);
        const auto now = std::chrono::system_clock::now().time_since_epoch();
        const auto time = std::chrono::duration_cast<std::chrono::nanoseconds>(now).count();
        lfgpu_ring_publish(&ring, nullptr, std::uint64_t(time));
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(100)); // the last frame can be read
    lfgpu_ring_close(&ring);
    return 0;
}
