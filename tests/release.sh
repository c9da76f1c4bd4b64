#!/usr/bin/env bash
# What .github/workflows/release.yml builds and checks for this platform, without publishing: with the Pythons of this
# machine, and with `twine check`. Arguments are stages, in the order below; without arguments, all of them.
# Files are in target/release-check; what was not checked is reported at the end. Needs Rust, Python 3 with venv, and the
# Python package index. A full run compiles the workspace three times.
set -eu
cd "$(dirname "$0")/.."
stages=(version tools wheel program sdist twine install containers crates site sums)
root=$PWD
out=$PWD/target/release-check
dist=$out/dist
skipped=()
target=$(rustc -vV | sed -n 's/^host: //p')
linux=$(case $target in *linux*) echo yes ;; esac)
mkdir -p "$dist"

skip() { skipped+=("$1"); }

# Version of the workspace; CITATION.cff and README.md must agree.
stage_version() {
    local version
    version=$(sed -n '/^\[workspace.package\]/,/^version/s/^version = "\(.*\)"/\1/p' Cargo.toml)
    grep -qx "version: $version" CITATION.cff || { echo "CITATION.cff has another version than $version"; return 1; }
    grep -q "version = {$version}" README.md || { echo "the BibTeX of README.md has another version than $version"; return 1; }
    # The workflow rejects a tag without this heading.
    grep -qE "^## ${version//./\\.} \([0-9-]+\)$" CHANGELOG.md || skip "version: CHANGELOG.md has no dated heading for $version"
    if grep -q 'example\.invalid' Cargo.toml; then skip "version: Cargo.toml has a placeholder for the address"; fi
}

# Environment with the tools of a list: `tools_of build` makes target/release-check/build. Pins with hashes are for the Python
# of the workflow; an older one takes the newest versions that it supports.
tools_of() {
    local env=$out/$1 list=(--require-hashes -r ".github/release/$1.txt")
    [ -x "$env/bin/python" ] || "${PYTHON:-python3}" -m venv "$env"
    if ! "$env/bin/python" -c "import sys; sys.exit(sys.version_info < (3, 13))"; then
        list=(-r ".github/release/$1.in")
        skip "$1: $("$env/bin/python" -V) is older than 3.13, so the tools are not those of $1.txt"
    fi
    "$env/bin/pip" install -q --disable-pip-version-check "${list[@]}"
}

stage_tools() { tools_of build; }

stage_wheel() {
    rm -f "$dist"/*.whl
    MATURIN_PEP517_ARGS="--locked --features=gpu ${linux:+--zig --compatibility manylinux_2_28}" PATH=$out/build/bin:$PATH \
        "$out/build/bin/pip" wheel -q --no-deps --no-build-isolation --wheel-dir "$dist" ./python
    if [ "$linux" ]; then "$out/build/bin/auditwheel" show "$dist"/*.whl | grep manylinux_2_28; fi
}

stage_program() {
    local name=pwrfgs-$target folder=$out/program/pwrfgs-$target
    if [ "$linux" ]; then
        PATH=$out/build/bin:$PATH cargo zigbuild --release --locked --features gpu --target "$target.2.28" # of glibc
    else
        cargo build --release --locked --features gpu --target "$target"
    fi
    rm -rf "$out/program" && mkdir -p "$folder"
    cp "${CARGO_TARGET_DIR:-target}/$target/release/pwrfgs" README.md CHANGELOG.md LICENSE-* "$folder"
    unzip -p "$dist"/*.whl '*/LICENSE-THIRD-PARTY' >"$folder/LICENSE-THIRD-PARTY"
    tar -czf "$dist/$name.tar.gz" -C "$out/program" "$name"
}

stage_sdist() {
    find "$dist" -name 'pwrfgs-[0-9]*.tar.gz' -delete
    PATH=$out/build/bin:$PATH "$out/build/bin/python" -m build --no-isolation --sdist --outdir "$dist" python
}

# Descriptions and metadata as the Python package index shows them.
stage_twine() {
    local files
    mapfile -t files < <(find "$dist" -name '*.whl' -o -name 'pwrfgs-[0-9]*.tar.gz')
    if [ ${#files[@]} = 0 ]; then echo "no wheel and no source distribution; run the stages wheel and sdist"; return 1; fi
    tools_of check
    "$out/check/bin/twine" check --strict "${files[@]}"
}

# The wheel with each Python of this machine, and the program, in an empty folder.
stage_install() {
    local folder python count=0
    for python in python3.{9..14}; do
        command -v "$python" >/dev/null || { skip "install: no $python"; continue; }
        folder=$(mktemp -d)
        "$python" -m venv "$folder/env" 2>/dev/null || { skip "install: $python has no venv"; continue; }
        "$folder/env/bin/pip" install -q --disable-pip-version-check "$dist"/*.whl
        (cd "$folder" && env/bin/python -c "import pwrfgs; print(pwrfgs.run('quickstart', set={'training.scale': 0.02}))")
        rm -rf "$folder"
        count=$((count + 1))
    done
    [ $count -gt 0 ] || { echo "no Python of 3.9 to 3.14"; return 1; }
    folder=$(mktemp -d)
    tar -xzf "$dist/pwrfgs-$target.tar.gz" -C "$folder"
    (cd "$folder" && "pwrfgs-$target/pwrfgs" run quickstart --scale 0.02 --out program)
    rm -rf "$folder"
}

# Both with the oldest libraries.
stage_containers() {
    if [ ! "$linux" ] || ! docker info >/dev/null 2>&1; then skip "containers: no docker on Linux"; return; fi
    local image
    for image in python:3.9-slim python:3.14-slim; do
        docker run --rm -v "$dist:/dist:ro" -w /tmp "$image" sh -ec '
            pip install /dist/*.whl
            pwrfgs run quickstart --scale 0.02'
    done
    docker run --rm -v "$dist:/dist:ro" -w /tmp almalinux:8 sh -ec '
        tar -xzf /dist/pwrfgs-*-linux-gnu.tar.gz --strip-components 1
        ./pwrfgs run quickstart --scale 0.02'
}

stage_crates() { cargo publish --workspace --locked --dry-run; }

stage_site() {
    local site=$out/site
    tools_of site
    "$site/bin/pip" install -q --disable-pip-version-check --no-deps --no-index --force-reinstall "$dist"/*.whl
    rm -rf "$out/run"
    "$site/bin/pwrfgs" run quickstart --out "$out/run"
    PATH=$site/bin:$PATH python "$root/site/build.py" "$out/run" "$out/pages"
}

stage_sums() { (cd "$dist" && rm -f SHA256SUMS && sha256sum -- * >SHA256SUMS && sha256sum --check SHA256SUMS); }

for stage in "${@:-${stages[@]}}"; do
    [[ " ${stages[*]} " == *" $stage "* ]] || { echo "unknown stage $stage; stages: ${stages[*]}"; exit 2; }
done
for stage in "${@:-${stages[@]}}"; do
    echo "== $stage"
    "stage_$stage"
done
if [ ${#skipped[@]} -gt 0 ]; then printf '== not checked: %s\n' "${skipped[@]}"; fi
