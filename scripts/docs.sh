#!/usr/bin/env bash
# Build the documentation into build/docs and check its links: ./scripts/docs.sh [--check].
# Sets up first; after that no network is needed. Warnings are errors. --check keeps no pages.
set -euo pipefail

# shellcheck source=scripts/setup.sh
. "$(dirname -- "${BASH_SOURCE[0]}")/setup.sh"
cd "$root"

case "${1:-}" in
--check)
    output=$(mktemp -d)
    trap 'rm -rf "$output"' EXIT
    ;;
'') output=build/docs ;;
*) die "unknown word $1; the only one is --check" ;;
esac

# The packages that pyproject.toml lists under "docs", a line each.
docs_packages() {
    "$python" -c '
import tomllib
with open("pyproject.toml", "rb") as file:
    print("\n".join(tomllib.load(file)["project"]["optional-dependencies"]["docs"]))'
}

if ! "$python" -c 'import furo, myst_parser, sphinx' 2>/dev/null; then
    say "installing Sphinx"
    docs_packages | "$python" -m pip install --quiet -r /dev/stdin ||
        die "pip could not install Sphinx; see the lines above"
fi

# Every page is read again (-E): those that are made from the code have no file that changes.
"$python" -m sphinx -E -W --keep-going -q -b html docs "$output"
"$python" scripts/docs/links.py "$output"
[ "${1:-}" = --check ] || echo "docs: build/docs/index.html"
