// Runs a fuzz target on files and on bytes from a seed, FUZZ_SEED or a fixed one, with any compiler, in tests and under
// sanitizers.
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <vector>

extern "C" int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int main(int argc, char **argv) {
    if (argc < 2) {
        std::fprintf(stderr, "usage: %s RANDOM_INPUTS [FILE or FOLDER ...]\n", argv[0]);
        return 2;
    }
    int files = 0;
    for (int i = 2; i < argc; ++i) {
        std::vector<std::filesystem::path> paths;
        if (std::filesystem::is_directory(argv[i]))
            for (const auto &entry : std::filesystem::directory_iterator(argv[i]))
                paths.push_back(entry.path());
        else
            paths.push_back(argv[i]);
        for (const auto &path : paths) {
            std::ifstream file(path, std::ios::binary);
            const std::vector<char> bytes{std::istreambuf_iterator<char>(file), {}};
            LLVMFuzzerTestOneInput(reinterpret_cast<const uint8_t *>(bytes.data()), bytes.size());
            ++files;
        }
    }
    const char *seed = std::getenv("FUZZ_SEED");
    std::mt19937 rng(seed ? uint32_t(std::strtoul(seed, nullptr, 10)) : 1u);
    const int rounds = std::atoi(argv[1]);
    for (int i = 0; i < rounds; ++i) {
        std::vector<uint8_t> bytes(rng() % 200);
        for (uint8_t &b : bytes)
            b = uint8_t(rng());
        LLVMFuzzerTestOneInput(bytes.data(), bytes.size());
    }
    std::printf("%d files and %d random inputs: nothing found\n", files, rounds);
    return 0;
}
