#!/usr/bin/env bash
# Makes .venv and installs toponav into it, with PyTorch for the processor alone
# (0.2 GB). For an NVIDIA GPU:  TORCH=cuda bash install.sh  (several GB).
set -euo pipefail
cd "$(dirname "$0")"

version=2.13.0
python=${PYTHON:-python3}
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
  echo "install.sh: Python must be 3.11 to 3.14, got $("$python" --version); set PYTHON=/path/to/python" >&2
  exit 1
}
[ -x .venv/bin/python ] || "$python" -m venv .venv

if [ "${TORCH:-cpu}" = cuda ] || [ "$(uname -s)" = Darwin ]; then
  .venv/bin/python -m pip install "torch==$version"
else
  # The "+cpu" build and nothing else: without it pip takes gigabytes of CUDA.
  # Its dependencies come with the next line, from the usual index.
  .venv/bin/python -m pip install --no-deps --retries 1 \
    --extra-index-url https://download.pytorch.org/whl/cpu "torch==$version+cpu"
fi
.venv/bin/python -m pip install -e ".[dev]"
