"""One scene as blocks, each trained as a task: `clgs train --blocks`."""
