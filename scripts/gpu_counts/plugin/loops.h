// Which loop an instruction is in: lanes that execute it in the same iteration do so together.
#pragma once

#include <memory>
#include <unordered_map>

#include "llvm/Analysis/LoopInfo.h"
#include "llvm/IR/Dominators.h"
#include "llvm/IR/Function.h"
#include "llvm/IR/Instructions.h"

namespace gpu_counts
{

class Loops
{
  public:
    // What begins an iteration of the innermost loop around an instruction; null outside of loops.
    const llvm::Instruction *iteration_of(const llvm::Instruction *instruction)
    {
        const llvm::BasicBlock *block = instruction->getParent();
        const llvm::Loop *loop = of(block->getParent()).getLoopFor(block);
        return loop ? &loop->getHeader()->front() : nullptr;
    }

    void clear()
    {
        known_.clear();
    }

  private:
    struct Known {
        explicit Known(llvm::Function &function) : tree(function), loops(tree)
        {
        }
        llvm::DominatorTree tree;
        llvm::LoopInfo loops;
    };

    const llvm::LoopInfo &of(const llvm::Function *function)
    {
        std::unique_ptr<Known> &known = known_[function];
        if (!known)
            known = std::make_unique<Known>(*const_cast<llvm::Function *>(function));
        return known->loops;
    }

    std::unordered_map<const llvm::Function *, std::unique_ptr<Known>> known_;
};

} // namespace gpu_counts
