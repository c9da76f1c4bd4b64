#!/usr/bin/env bash
# Tests of the Python package with what cargo has built for development: its compiled half beside the Python half, in single
# and in double precision, and the notebooks; the site, which has its API. Arguments go to cargo. Says so where there is no
# Python to test with.
set -eu
cd "$(dirname "$0")/.."
target=${CARGO_TARGET_DIR:-target}

# What has not been tested, and why; the end.
skip() {
    echo "== Python: $1"
    if [ -n "${PWRFGS_SKIPPED:-}" ]; then echo "tests of the Python package: $1" >>"$PWRFGS_SKIPPED"; fi
    exit 0
}

python=${PYTHON:-python3}
"$python" -c "import sys; sys.exit(sys.version_info < (3, 9))" 2>/dev/null || skip "no Python of 3.9 or later"

# What the tests import, in an environment of their own that is made once.
wanted=$(sed -n 's/^test = \[\(.*\)\]/\1/p' python/pyproject.toml | tr -d '",'; echo "build numpy tqdm")
env=$target/python-env-$(echo "$wanted" "$("$python" -V)" | sha256sum | cut -c1-12)
if [ ! -f "$env/complete" ]; then
    rm -rf "$env"
    "$python" -m venv "$env" >/dev/null 2>&1 || skip "python3 -m venv makes no environment (Debian: apt-get install python3-venv)"
    # shellcheck disable=SC2086 # a word a package
    "$env/bin/pip" install -q --disable-pip-version-check $wanted >"$env/log" 2>&1 ||
        { tail -n 3 "$env/log"; skip "pip cannot install what the tests import"; }
    touch "$env/complete"
fi

# The package as it is installed, but for who built it.
together() {
    local folder=$target/python-package/$1
    rm -rf "$folder" && mkdir -p "$folder"
    cp -r python/pwrfgs "$folder/"
    rm -f "$folder"/pwrfgs/*.so
    for name in lib_pwrfgs.so lib_pwrfgs.dylib; do
        if [ -f "$target/debug/$name" ]; then cp "$target/debug/$name" "$folder/pwrfgs/_pwrfgs.abi3.so"; fi
    done
    PYTHONPATH=$folder "$env/bin/python" -B -m pwrfgs._stubs
}

test_package() {
    PYTHONPATH=$(cd "$target/python-package/$1" && pwd) PYTHONDONTWRITEBYTECODE=1 PWRFGS_CLI=$(cd "$target" && pwd)/debug/pwrfgs \
        MPLBACKEND=Agg "$env/bin/python" -m pytest -q --no-header -p no:cacheprovider --rootdir python -rs "${@:2}"
}

# Debian has a torch of a size that can be installed, for its own Python.
test_torch() {
    local torch=(/usr/bin/python3 -B python/tests/gradcheck.py)
    if "$env/bin/python" -c "import torch" 2>/dev/null; then
        : # it was among the tests
    elif "${torch[0]}" -c "import numpy, torch" 2>/dev/null; then
        PYTHONPATH=$(cd "$target/python-package/$1" && pwd) "${torch[@]}"
        if [ "$1" = f32 ]; then test_torch_notebook; fi
    elif [ "$1" = f64 ]; then # at the end
        skip "no torch (Debian: apt-get install python3-torch), so nobody ran gradcheck"
    fi
}

# Its notebook, with a matplotlib and a kernel that know the NumPy of that torch.
test_torch_notebook() {
    local torch=$target/python-torch-env
    if [ ! -f "$torch/complete" ]; then
        rm -rf "$torch" && /usr/bin/python3 -m venv --system-site-packages "$torch" &&
            "$torch/bin/pip" install -q --disable-pip-version-check "numpy<2" matplotlib nbclient nbformat ipykernel pytest tqdm >"$env/log" 2>&1 ||
            { tail -n 3 "$env/log"; (skip "pip cannot install what the notebook of PyTorch imports"); return; }
        touch "$torch/complete"
    fi
    env=$torch test_package f32 python/tests/test_notebooks.py -k torch
}

# A wheel that pip builds from the source distribution, outside of the repository. Not optimised and with the features of the
# tests, so that only the crates of this project are compiled anew; their folder has a fixed name, so that a second run
# compiles nothing.
test_wheel() {
    local folder
    folder=${TMPDIR:-/tmp}/pwrfgs-sdist-$(id -u)
    rm -rf "$target/python-package/wheel" "$folder" && mkdir "$folder"
    "$env/bin/python" -m build --sdist --outdir "$folder" python >"$folder/log" 2>&1 || { tail "$folder/log"; return 1; }
    tar -xzf "$folder"/pwrfgs-*.tar.gz -C "$folder" --strip-components 1
    grep -q "^Description-Content-Type: text/markdown" "$folder/PKG-INFO" # shown by the package index
    CARGO_TARGET_DIR=$(cd "$target" && pwd) MATURIN_PEP517_ARGS="--profile dev --features as-tested" \
        "$env/bin/pip" install -q --disable-pip-version-check --no-deps --target "$target/python-package/wheel" "$folder"
    test_package wheel python/tests/test_types.py python/tests/test_wheel.py
}

# The site from a short run, with its links; the workflows of the repository by their schema, and for holes in their security.
test_site() {
    "$env/bin/pip" install -q --disable-pip-version-check -r site/requirements.txt >"$env/log" 2>&1 ||
        { tail -n 3 "$env/log"; (skip "no site was built, since pip cannot install its tools"); return; }
    local program=$target/debug/pwrfgs run=$target/python-package/site-run
    rm -rf "$run"
    "$program" run -q pipelines/quickstart.ron --out "$run" --scale 0.01 --set data.samples=100 \
        --set 'baselines=[MeanSpectrum()]' >/dev/null
    PATH=$(cd "$env/bin" && pwd):$PATH PYTHONPATH=$target/python-package/f32 \
        python -B site/build.py "$run" "$target/site" --program "$program"
    "$env/bin/check-jsonschema" --builtin-schema vendor.github-workflows .github/workflows/*.yml
    "$env/bin/check-jsonschema" --builtin-schema vendor.dependabot .github/dependabot.yml
    "$env/bin/zizmor" --offline -q .github
}

# Targets are those of the other tests, tests too, so that features are the same and nothing is compiled twice.
echo "== Python, f32"
cargo build "$@" --workspace ${PWRFGS_FEATURES:-} --lib --bins --tests
together f32
test_package f32 python/tests --ignore python/tests/test_types.py --ignore python/tests/test_wheel.py # from a wheel below
test_torch f32
echo "== the site and the workflows"
test_site
echo "== Python, from a wheel"
test_wheel
echo "== Python, f64: derivatives against central differences"
# shellcheck disable=SC2086 # a word a package
cargo build "$@" ${PWRFGS_FORMULAS:--p pwrfgs -p pwrfgs-cli -p pwrfgs-python} --features pwrfgs/f64 --lib --bins --test all
together f64
test_package f64 python/tests/test_numbers.py
test_torch f64
