// One warp between two barriers: what each of its lanes executed and asked of memory in which
// iteration of the innermost loop.
//
// Oclgrind runs a work-item until a barrier, then the next one. Lanes that execute an instruction
// in the same iteration, by its number since the barrier, count as one issue; so do their requests.
// Outside of loops, and in functions that are called, the n-th time counts as the n-th iteration.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <tuple>
#include <vector>

#include "cost.h"
#include "memory.h"

namespace gpu_counts
{

constexpr unsigned LANES = 32;

enum class Kind { READ, WRITE, ATOMIC };

// Sums of a launch, by name; those of a line of the source have the same names.
using Sums = std::map<std::string, uint64_t>;

struct Place {
    Cost cost;
    std::string line;
    uint32_t iteration; // the instruction that begins one; its own number outside of loops
};

class Warp
{
  public:
    void begin_lane()
    {
        for (const uint32_t id : run_)
            times_[id] = 0;
        run_.clear();
    }

    // `id` is executed once more by the present lane.
    void executed(uint32_t id, const Place &place)
    {
        grow(id);
        if (times_[id]++ == 0)
            run_.push_back(id);
        const uint32_t n = place.iteration == id ? times_[id] - 1 : number_of(place.iteration);
        std::vector<bool> &seen = seen_[id];
        if (n >= seen.size())
            seen.resize(n + 1);
        if (!seen[n]) {
            seen[n] = true;
            if (issues_[id]++ == 0)
                issued_.push_back(id);
        }
        part_ = 0;
    }

    // What the instruction that comes next asks for; every part of it is a request of its own.
    void access(uint32_t id, const Place &place, unsigned space, Kind kind, const Access &access)
    {
        grow(id);
        const uint32_t n = place.iteration == id ? times_[id] : number_of(place.iteration);
        requests_[{id, n, space, kind}].push_back({part_++, access});
    }

    // Adds up what the warp did, and forgets it.
    void finish(const std::vector<Place> &places, Sums &sums, std::map<std::string, Sums> &lines)
    {
        for (const uint32_t id : issued_) {
            sums["warp_instructions"] += uint64_t{issues_[id]} * places[id].cost.issued;
            sums["warp_special"] += uint64_t{issues_[id]} * places[id].cost.special;
            sums["warp_operations"] += uint64_t{issues_[id]} * places[id].cost.operations;
            if (places[id].cost.issued)
                lines[places[id].line]["warp_instructions"] +=
                    uint64_t{issues_[id]} * places[id].cost.issued;
            issues_[id] = 0;
            seen_[id].clear();
        }
        issued_.clear();
        begin_lane();
        for (const auto &one : requests_)
            finish_request(one.first, one.second, sums, lines[places[std::get<0>(one.first)].line]);
        requests_.clear();
    }

  private:
    void grow(uint32_t id)
    {
        if (id < times_.size())
            return;
        times_.resize(id + 1);
        issues_.resize(id + 1);
        seen_.resize(id + 1);
    }

    uint32_t number_of(uint32_t iteration) const
    {
        return iteration < times_.size() ? times_[iteration] : 0;
    }

    using Key = std::tuple<uint32_t, uint32_t, unsigned, Kind>;
    struct Part {
        uint32_t part;
        Access access;
    };

    static void add(Sums &sums, Sums &line, const std::string &name, uint64_t value)
    {
        sums[name] += value;
        line[name] += value;
    }

    static void finish_request(const Key &key, const std::vector<Part> &parts, Sums &sums,
                               Sums &line)
    {
        const Kind kind = std::get<3>(key);
        const char *verb = kind == Kind::WRITE ? "written" : "read";
        std::map<uint32_t, std::vector<Access>> by_part;
        std::vector<Access> all;
        for (const Part &one : parts) {
            by_part[one.part].push_back(one.access);
            all.push_back(one.access);
        }
        if (std::get<2>(key) == LOCAL) {
            for (const auto &one : by_part)
                finish_local(one.second, kind, sums, line);
            return;
        }
        uint64_t asked = 0;
        for (const Access &one : all)
            asked += one.bytes;
        add(sums, line, std::string("global_asked_") + verb, asked);
        add(sums, line, std::string("global_used_") + verb, WORD * touched(all, WORD).size());
        add(sums, line, std::string("global_sectors_") + verb, touched(all, SECTOR).size());
        for (const auto &one : by_part) {
            const uint64_t sectors = touched(one.second, SECTOR).size();
            add(sums, line, "global_requests", 1);
            add(sums, line, "global_wavefronts", (sectors + 3) / 4);
        }
    }

    static void finish_local(const std::vector<Access> &accesses, Kind kind, Sums &sums, Sums &line)
    {
        const Wavefronts found = wavefronts(accesses, kind == Kind::ATOMIC);
        add(sums, line, "local_requests", 1);
        add(sums, line, "local_wavefronts", found.needed);
        add(sums, line, "local_ideal_wavefronts", found.ideal);
    }

    std::vector<uint32_t> times_, issues_, run_, issued_;
    std::vector<std::vector<bool>> seen_;
    std::map<Key, std::vector<Part>> requests_;
    uint32_t part_ = 0;
};

} // namespace gpu_counts
