// A plugin of Oclgrind that counts what a GPU with warps of 32 lanes would have to do for every
// launch of a kernel; it appends a line of JSON for each to the file CLGS_GPU_COUNTS.
//
// Left out: memory of a work-item alone (registers, if the compiler does its work), constants, and
// instructions that a GPU does not need (cost.h).
#include <cstdlib>
#include <fstream>
#include <string>
#include <unordered_map>
#include <vector>

#include "llvm/IR/DebugInfoMetadata.h"
#include "llvm/IR/DebugLoc.h"
#include "llvm/Support/CommandLine.h"

#include "cost.h"
#include "intrinsics.h"
#include "loops.h"
#include "memory.h"
#include "oclgrind.h"
#include "warp.h"

namespace gpu_counts
{

using namespace oclgrind;

class Counter : public Plugin
{
  public:
    explicit Counter(const Context *context) : Plugin(context)
    {
        add_missing_intrinsics();
    }

    bool isThreadSafe() const override
    {
        return false; // work-groups run one after the other
    }

    void kernelBegin(const KernelInvocation *invocation) override
    {
        ids_.clear();
        loops_.clear();
        last_instruction_ = nullptr;
        places_.clear();
        sums_.clear();
        lines_.clear();
        read_ = Footprint();
        written_ = Footprint();
        const Size3 size = invocation->getGlobalSize(), groups = invocation->getNumGroups();
        sums_["work_items"] = size.x * size.y * size.z;
        sums_["work_groups"] = groups.x * groups.y * groups.z;
    }

    void kernelEnd(const KernelInvocation *invocation) override
    {
        finish_warp();
        sums_["compulsory_read"] = read_.bytes();
        sums_["compulsory_written"] = written_.bytes();
        sums_["group_sectors_read"] = read_.sectors_by_group();
        sums_["static_instructions"] = static_cost(invocation->getKernel()->getFunction());
        write(invocation->getKernel()->getName());
    }

    void workItemBegin(const WorkItem *) override
    {
        item_ = nullptr;
    }

    void workGroupBarrier(const WorkGroup *, uint32_t) override
    {
        finish_warp();
        ++sums_["barriers"];
    }

    void workGroupComplete(const WorkGroup *) override
    {
        finish_warp();
    }

    void instructionExecuted(const WorkItem *item, const llvm::Instruction *instruction,
                             const TypedValue &result) override
    {
        mend_truth(instruction->getType(), result);
        select(item);
        const uint32_t id = id_of(instruction);
        warp_.executed(id, places_[id]);
        lane_instructions_ += places_[id].cost.issued;
        lane_operations_ += places_[id].cost.operations;
        lane_special_ += places_[id].cost.special;
    }

    void memoryLoad(const Memory *memory, const WorkItem *item, size_t address,
                    size_t size) override
    {
        access(memory, item, Kind::READ, address, size);
    }

    void memoryStore(const Memory *memory, const WorkItem *item, size_t address, size_t size,
                     const uint8_t *) override
    {
        access(memory, item, Kind::WRITE, address, size);
    }

    void memoryAtomicLoad(const Memory *memory, const WorkItem *item, AtomicOp, size_t address,
                          size_t size) override
    {
        const bool local = memory->getAddressSpace() == LOCAL;
        ++sums_[local ? "local_atomics" : "global_atomics"];
        access(memory, item, Kind::ATOMIC, address, size);
    }

  private:
    // The work-item that runs now; its warp is done when one of another warp runs.
    void select(const WorkItem *item)
    {
        if (item == item_)
            return;
        const Size3 id = item->getLocalID(), size = item->getWorkGroup()->getGroupSize();
        const size_t lane = id.x + size.x * (id.y + size.y * id.z);
        const size_t group = item->getWorkGroup()->getGroupIndex();
        if (lane / LANES != warp_number_ || group != group_)
            finish_warp();
        warp_number_ = lane / LANES;
        group_ = group;
        item_ = item;
        warp_.begin_lane();
    }

    void finish_warp()
    {
        item_ = nullptr;
        warp_.finish(places_, sums_, lines_);
        sums_["lane_instructions"] += lane_instructions_;
        sums_["lane_operations"] += lane_operations_;
        sums_["lane_special"] += lane_special_;
        lane_instructions_ = lane_operations_ = lane_special_ = 0;
    }

    void access(const Memory *memory, const WorkItem *item, Kind kind, size_t address, size_t size)
    {
        const unsigned space = memory->getAddressSpace();
        if (!item || !size || (space != GLOBAL && space != LOCAL))
            return;
        select(item);
        const llvm::Instruction *instruction = item->getCurrentInstruction();
        const uint32_t id = id_of(instruction);
        if (space == GLOBAL && kind != Kind::WRITE)
            read_.touch(address, size, group_);
        if (space == GLOBAL && kind != Kind::READ)
            written_.touch(address, size, group_);
        const size_t part = size / std::max<size_t>(1, parts_of(instruction));
        for (size_t at = 0; at < size; at += part)
            warp_.access(id, places_[id], space, kind,
                         {address + at, static_cast<uint32_t>(std::min(part, size - at))});
    }

    // Requests that an access of an instruction is made of.
    static size_t parts_of(const llvm::Instruction *instruction)
    {
        return llvm::isa<llvm::LoadInst>(instruction) || llvm::isa<llvm::StoreInst>(instruction) ||
                       is_vector_call(instruction)
                   ? cost_of(instruction).issued
                   : 1;
    }

    static bool is_vector_call(const llvm::Instruction *instruction)
    {
        const auto *call = llvm::dyn_cast<llvm::CallInst>(instruction);
        if (!call || !call->getCalledFunction())
            return false;
        const std::string name = plain_name(call->getCalledFunction()->getName().str());
        return starts(name, "vload") || starts(name, "vstore");
    }

    uint32_t id_of(const llvm::Instruction *instruction)
    {
        if (instruction == last_instruction_)
            return last_id_;
        const auto [found, added] = ids_.try_emplace(instruction, places_.size());
        const uint32_t id = found->second;
        if (added) {
            places_.push_back({cost_of(instruction), line_of(instruction), id});
            const llvm::Instruction *begin = loops_.iteration_of(instruction);
            const uint32_t iteration = begin && begin != instruction ? id_of(begin) : id;
            places_[id].iteration = iteration;
        }
        last_instruction_ = instruction;
        return last_id_ = id;
    }

    static std::string line_of(const llvm::Instruction *instruction)
    {
        const llvm::DebugLoc &at = instruction->getDebugLoc();
        if (!at)
            return "";
        const auto *scope = llvm::cast<llvm::DIScope>(at.getScope());
        return scope->getFilename().str() + ":" + std::to_string(at.getLine());
    }

    static void put(std::ostream &out, const Sums &sums)
    {
        const char *separator = "";
        for (const auto &one : sums) {
            out << separator << '"' << one.first << "\": " << one.second;
            separator = ", ";
        }
    }

    void write(const std::string &kernel) const
    {
        const char *file = std::getenv("CLGS_GPU_COUNTS");
        if (!file)
            return;
        std::ofstream out(file, std::ios::app);
        out << "{\"kernel\": \"" << kernel << "\", \"sums\": {";
        put(out, sums_);
        out << "}, \"lines\": {";
        const char *separator = "";
        for (const auto &one : lines_) {
            out << separator << '"' << one.first << "\": {";
            put(out, one.second);
            out << '}';
            separator = ", ";
        }
        out << "}}\n";
    }

    std::unordered_map<const llvm::Instruction *, uint32_t> ids_;
    std::vector<Place> places_;
    Loops loops_;
    const llvm::Instruction *last_instruction_ = nullptr;
    uint32_t last_id_ = 0;
    Sums sums_;
    std::map<std::string, Sums> lines_;
    Footprint read_, written_;
    Warp warp_;
    const WorkItem *item_ = nullptr;
    size_t warp_number_ = 0, group_ = 0;
    uint64_t lane_instructions_ = 0, lane_operations_ = 0, lane_special_ = 0;
};

} // namespace gpu_counts

static gpu_counts::Counter *counter;

// A GPU loads whole vectors from local memory; without its cost model LLVM would take them apart.
static void keep_vectors()
{
    const char *const options[] = {"gpu_counts", "-disable-vector-combine"};
    llvm::cl::ParseCommandLineOptions(2, options);
}

extern "C" void initializePlugins(oclgrind::Context *context)
{
    keep_vectors();
    counter = new gpu_counts::Counter(context);
    context->registerPlugin(counter);
}

extern "C" void releasePlugins(oclgrind::Context *context)
{
    context->unregisterPlugin(counter);
    delete counter;
}
