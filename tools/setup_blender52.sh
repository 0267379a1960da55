#!/bin/sh
# Create a Python 3.13 environment with bpy 5.2 in the folder given, for the tests of Blender 5.2.
# Without a Python 3.13 on this machine it says so and leaves the folder empty: those tests are then skipped.
set -eu
folder=$1
beside=$(dirname "$(python3 -c 'import sys; print(sys.base_prefix)')")
for python in python3.13 "$beside"/3.13*/bin/python3.13; do
    if "$python" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 13))' 2>/dev/null; then
        "$python" -m venv "$folder"
        "$folder/bin/python" -m pip install --quiet --disable-pip-version-check bpy==5.2.3
        exit 0
    fi
done
echo "No Python 3.13 found: the tests of Blender 5.2 will be skipped."
