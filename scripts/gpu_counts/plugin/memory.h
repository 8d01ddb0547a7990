// Requests of a warp to memory: sectors and wavefronts of one, and what a launch touches in all.
#pragma once

#include <algorithm>
#include <cstdint>
#include <unordered_map>
#include <vector>

namespace gpu_counts
{

constexpr uint64_t WORD = 4, SECTOR = 32, BANKS = 32;

inline size_t distinct(std::vector<uint64_t> &values)
{
    std::sort(values.begin(), values.end());
    values.erase(std::unique(values.begin(), values.end()), values.end());
    return values.size();
}

struct Access {
    uint64_t address;
    uint32_t bytes;
};

// Distinct words or sectors that some accesses touch, sorted.
inline std::vector<uint64_t> touched(const std::vector<Access> &accesses, uint64_t unit)
{
    std::vector<uint64_t> units;
    for (const Access &one : accesses)
        for (uint64_t at = one.address / unit; at <= (one.address + one.bytes - 1) / unit; ++at)
            units.push_back(at);
    distinct(units);
    return units;
}

struct Wavefronts {
    uint64_t needed, ideal;
};

// Lanes that touch the same word are served at once; atomics on one word are not.
inline Wavefronts wavefronts(const std::vector<Access> &accesses, bool atomic)
{
    uint64_t in_bank[BANKS] = {0};
    const std::vector<uint64_t> words = touched(accesses, WORD);
    if (atomic)
        for (const Access &one : accesses)
            ++in_bank[one.address / WORD % BANKS];
    else
        for (const uint64_t word : words)
            ++in_bank[word % BANKS];
    const uint64_t worst = *std::max_element(in_bank, in_bank + BANKS);
    const uint64_t ideal = (words.size() + BANKS - 1) / BANKS;
    return {worst, ideal};
}

// What a launch touches of global memory: words, and sectors again in every work-group.
class Footprint
{
  public:
    void touch(uint64_t address, uint32_t bytes, uint64_t group)
    {
        for (uint64_t word = address / WORD; word <= (address + bytes - 1) / WORD; ++word) {
            Page &page = pages_[word / WORDS];
            const uint64_t in = word % WORDS, sector = in * WORD / SECTOR;
            words_ += !page.has[in];
            page.has[in] = true;
            by_group_ += page.group[sector] != group + 1;
            page.group[sector] = group + 1;
        }
    }
    uint64_t bytes() const
    {
        return words_ * WORD;
    }
    // Sectors, if each work-group had a cache of its own that forgets nothing.
    uint64_t sectors_by_group() const
    {
        return by_group_;
    }

  private:
    static constexpr uint64_t WORDS = 1024;
    struct Page {
        bool has[WORDS] = {false};
        uint64_t group[WORDS * WORD / SECTOR] = {0};
    };
    std::unordered_map<uint64_t, Page> pages_;
    uint64_t words_ = 0, by_group_ = 0;
};

} // namespace gpu_counts
