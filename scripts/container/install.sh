#!/usr/bin/env bash
# What both recipes run inside a bare Debian 12, as root, with the repository in place: the Debian route of
# docs/installation.md.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
export DEBIAN_FRONTEND=noninteractive
apt-get -qq update
apt-get -qq install -y --no-install-recommends ca-certificates make
rm -rf .venv
make install
# numba takes compiled kernels only from folders that it may write to: without this, whoever is not root waits for a
# minute until they are compiled again.
find src -name __pycache__ -exec chmod -R a+rwX {} +
rm -rf /var/lib/apt/lists/* /root/.cache
