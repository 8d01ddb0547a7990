#!/usr/bin/env bash
# The whole way on one machine: ./scripts/demo.sh [PHOTOS]. Sets up, then trains on the folder of
# photos, or on photos that it makes itself; --help lists more.
set -euo pipefail

# shellcheck source=scripts/setup.sh
. "$(dirname -- "${BASH_SOURCE[0]}")/setup.sh"

exec "$python" "$root/scripts/demo/run.py" "$@"
