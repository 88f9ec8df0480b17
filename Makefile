# Every target works on a fresh clone: it makes .venv itself. PYTHON chooses the interpreter (3.11 or newer).
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP ?= $(BIN)/python -m pip
INSTALLED := $(VENV)/.installed
DEVELOPED := $(VENV)/.developed
LIBRARY := build/native/.built
NATIVE_TESTS := build/native/.tests-built
CMAKE := $(BIN)/cmake -G Ninja -S csrc -DCMAKE_MAKE_PROGRAM=$(abspath $(BIN)/ninja) -DCMAKE_BUILD_TYPE=Release

# Where Linux takes torch from: PyTorch's builds without CUDA, which save 2.7 GB. TORCH_INDEX= selects PyPI.
ifeq ($(shell uname -s),Linux)
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
endif

# Blenders for the add-on tests of `make test`: newest, oldest, all, versions, or none.
BLENDER ?= newest
# The Blender that ends `make demo`: a version, newest, or none; older ones may not open what it saves.
DEMO_BLENDER ?= newest
# How pytest-xdist distributes tests: to a process per core, as far as memory allows, each with one thread
# (tests/conftest.py). `make test WORKERS=` uses one process, WORKERS="-n 4" four.
WORKERS ?= -n logical --dist worksteal
export WORKERS
# Tests start hundreds of Python programs; compiled modules are kept, or each would compile gscore anew.
unexport PYTHONDONTWRITEBYTECODE
# Platforms of `make extension`: empty for this machine, all, or names like windows-x64.
PLATFORMS ?=

.PHONY: help demo install test test-slow stress test-blender test-window extension shaders test-native test-widths test-scalar test-neon sanitize fuzz faults lint format bench experiment-depth docs wheel clean

# Lists what follows the two # of each target.
help:  ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-17s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))

# The environment of a user. An editable install lists the packages that exist, so a new package repeats it; no build.
# torch is installed first and alone, so that an index without an answer costs seconds once and not per package.
# -qq shows pip's errors only, not warnings about its setup. Retry warnings of 300 characters ignore any number of q, so
# the output about an optional index is dropped; one sentence follows.
$(INSTALLED): pyproject.toml constraints.txt $(wildcard gscore/*/__init__.py gscore/*/*/__init__.py)
	@echo "Installing into $(VENV): 1.5 GB, half of it torch"
	@$(PYTHON) -m venv $(VENV)
	@$(PIP) install -qq --upgrade pip
ifneq ($(TORCH_INDEX),)
	@$(PIP) install -qqq --retries 1 --timeout 15 --no-deps --index-url $(TORCH_INDEX) --constraint constraints.txt torch \
		2> /dev/null || echo "$(TORCH_INDEX) has no torch, so it comes from PyPI with 2.7 GB of CUDA; TORCH_INDEX=URL sets another index."
endif
	@$(PIP) install -qq --constraint constraints.txt --config-settings wheel.cmake=false --editable '.[all]' \
		'cmake>=3.25' 'ninja>=1.11'
	@touch $@

# Linters and packages of the tests, for developers.
$(DEVELOPED): $(INSTALLED)
	@echo "Adding linters and test packages to $(VENV)"
	@$(PIP) install -qq --constraint constraints.txt --group dev
	@touch $@

# The native library in the checkout, rebuilt after changes in csrc/.
$(LIBRARY): $(INSTALLED) $(wildcard csrc/CMakeLists.txt csrc/include/*.h csrc/include/gscore/*.h csrc/shared/* csrc/src/* csrc/gpu/*.* csrc/gpu/shaders/spirv/*)
	@echo "Building the native library"
	@$(CMAKE) -B build/native -DGS_TESTS=OFF > /dev/null
	@$(BIN)/cmake --build build/native
	@touch $@

# The same build folder with the native tests.
$(NATIVE_TESTS): $(LIBRARY) $(wildcard csrc/tests/* csrc/fuzz/*)
	@$(CMAKE) -B build/native -DGS_TESTS=ON > /dev/null
	@$(BIN)/cmake --build build/native
	@touch $@

install: $(LIBRARY)  ## .venv/bin/gscore with its native library

# Trains the bundled capture and leaves out/demo/{point_cloud.ply,metrics.json,report.html}; then brings it into Blender
# (the bpy module) with cameras and splats and renders it there: out/demo/{demo.blend,blender.png}.
demo: $(LIBRARY)  ## trains the bundled capture into out/demo and ends in Blender (DEMO_BLENDER=none: without)
	$(BIN)/gscore train examples/studio -o out/demo --overwrite --preset preview --mask-mode none --hold-out 6
	$(BIN)/gscore render out/demo/point_cloud.ply --cameras examples/studio --test -o out/demo/renders
ifneq ($(DEMO_BLENDER),none)
	@mkdir -p build/blender-profile
	@bpy=$$($(BIN)/python tools/build/bpy_venvs.py $(DEMO_BLENDER)); status=$$?; \
	if [ $$status = 3 ]; then echo "so the demo ends without Blender."; exit 0; fi; \
	[ $$status = 0 ] && BLENDER_USER_RESOURCES=$(CURDIR)/build/blender-profile $$bpy examples/photos_to_blend.py \
		examples/studio --splats out/demo/point_cloud.ply -o out/demo/demo.blend --render out/demo/blender.png \
		--overwrite && \
	version=$$(basename $$(dirname $$(dirname $$bpy))) && \
	echo "Open out/demo/blender.png and, in Blender $$version or newer with the add-on (make extension), out/demo/demo.blend"
endif
	@echo "Open out/demo/report.html"

test: $(DEVELOPED) $(NATIVE_TESTS)  ## everything quick; BLENDER=none leaves the add-on out
	$(BIN)/python -m pytest -q $(WORKERS) -m "not slow and not window"
	$(BIN)/ctest --test-dir build/native --output-on-failure
ifneq ($(BLENDER),none)
	$(BIN)/python tools/build/test_blender.py $(BLENDER) -- -m "not slow"
endif

test-slow: $(DEVELOPED) $(NATIVE_TESTS)  ## the tests that take minutes; BLENDER=none leaves the add-on out
	$(BIN)/python -m pytest -q $(WORKERS) -m "slow and not window"
ifneq ($(BLENDER),none)
	$(BIN)/python tools/build/test_blender.py $(BLENDER) -- -m slow
endif

# The add-on's tests, the slow ones too, in every Blender of tools/build/bpy_venvs.py: 350 MB and half a minute each at first.
test-blender: $(LIBRARY)  ## the add-on's tests in every Blender known
	$(BIN)/python tools/build/test_blender.py all

# GSCORE_BLENDER=PROGRAM names one; Xvfb and ImageMagick must be there, or the tests are skipped.
test-window: $(LIBRARY) $(DEVELOPED)  ## the add-on in the window of a Blender on PATH
	$(BIN)/python -m pytest -q -m window tests/window

# dist/gscore_splats-<version>-<platform>.zip, checked by Blender's validator.
extension: $(LIBRARY)  ## the Blender extension into dist/; PLATFORMS=all for all of Blender's platforms
	$(BIN)/python tools/build/build_extension.py $(PLATFORMS)

# Needs glslangValidator and spirv-val (Debian's glslang-tools and spirv-tools).
shaders: $(INSTALLED)  ## SPIR-V of csrc/gpu/shaders, after changes there
	$(BIN)/python tools/build/shaders.py

test-native: $(NATIVE_TESTS)  ## the C++ tests
	$(BIN)/ctest --test-dir build/native --output-on-failure

# For machines that lack AVX2 and AVX-512.
test-widths: $(INSTALLED)  ## the portable kernels at the vector widths of AVX2 and AVX-512
	for n in 8 16; do \
		$(CMAKE) -B build/lanes-$$n -DGS_TESTS=ON -DGS_SCALAR_LANES=$$n > /dev/null && \
		$(BIN)/cmake --build build/lanes-$$n && \
		GSCORE_ISA=scalar $(BIN)/ctest --test-dir build/lanes-$$n --output-on-failure || exit 1; \
	done

test-scalar: $(DEVELOPED) $(LIBRARY)  ## the raster and unit tests with the portable kernels
	GSCORE_ISA=scalar $(BIN)/python -m pytest -q $(WORKERS) -m "not slow" tests/raster tests/unit

test-neon: $(INSTALLED)  ## NEON, emulated (Debian's g++-aarch64-linux-gnu and qemu-user-static)
	$(CMAKE) -B build/neon -DGS_TESTS=ON -DCMAKE_SYSTEM_NAME=Linux -DCMAKE_SYSTEM_PROCESSOR=aarch64 \
		-DCMAKE_CXX_COMPILER=aarch64-linux-gnu-g++ > /dev/null
	$(BIN)/cmake --build build/neon
	for t in match mesh native stereo; do \
		qemu-aarch64-static -L /usr/aarch64-linux-gnu -E LD_LIBRARY_PATH=build/neon build/neon/test_$$t || exit 1; \
	done

# Every numerical stress test in its long version, with every instruction set: ten minutes to an hour on two cores, half of it
# for S30's 200 000 steps. STRESS="--only S06" and the like choose.
stress: $(DEVELOPED) $(LIBRARY)  ## the numerical stress tests in their long versions, ten minutes to an hour
	$(BIN)/gscore stress --full --isa all $(STRESS)
	$(BIN)/python -m pytest -q -m slow tests/stress/test_determinism.py

sanitize: $(INSTALLED)  ## the C++ tests under the address, undefined-behaviour and thread sanitizers
	for s in address,undefined thread; do \
		d=build/sanitize-$${s%%,*}; \
		$(CMAKE) -B $$d -DGS_TESTS=ON -DGS_SANITIZE=$$s > /dev/null && \
		$(BIN)/cmake --build $$d && $(BIN)/ctest --test-dir $$d --output-on-failure || exit 1; \
	done

# In the C entry points (under libFuzzer and sanitizers with Debian's clang and libclang-rt-14-dev), readers and rasterizer.
FUZZ_SECONDS ?= 60
fuzz: $(DEVELOPED) $(NATIVE_TESTS)  ## hunts for crashes for FUZZ_SECONDS (60) each
	$(BIN)/python tools/break/fuzz.py $(FUZZ_SECONDS)

# Kills, full disks, vanishing photos, clock jumps and more, done to trainings; 15 to 30 minutes on two cores.
KILLS ?= 50
faults: $(LIBRARY)  ## kills, full disks, damaged files, done to real trainings
	$(BIN)/python tools/break/faults.py --kills $(KILLS)
	$(BIN)/python tools/break/ranks.py

lint: $(DEVELOPED)  ## ruff, pyright, clang-format, and checks of the workflows
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/pyright -p tools/build/addon_pyright.json
	$(BIN)/clang-format --dry-run --Werror $$(git ls-files 'csrc/*.h' 'csrc/*.cpp' ':!csrc/third_party')
	$(BIN)/check-jsonschema --builtin-schema vendor.github-workflows .github/workflows/*.yml
	$(BIN)/check-jsonschema --builtin-schema vendor.github-issue-forms .github/ISSUE_TEMPLATE/*.yml
	$(BIN)/zizmor --offline --quiet --min-severity medium .github/workflows

format: $(DEVELOPED)  ## clang-format, ruff's formatter and safe fixes, and text wrapped at 120 columns
	$(BIN)/python tools/build/wrap_text.py $$(git ls-files '*.md')
	$(BIN)/clang-format -i $$(git ls-files 'csrc/*.h' 'csrc/*.cpp' ':!csrc/third_party')
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(LIBRARY)  ## speed of the rasterizer here
	$(BIN)/gscore bench raster

# Trains with and without depth, from 6 to 50 views, and leaves out/experiment-depth/{results.json,results.md,*.png}; goes
# on where it was stopped. About eight minutes on two cores; EXPERIMENT=--quick takes one. Other tables of
# docs/experiments/2026-11-depth.md: EXPERIMENT="--table study" (auto, switches, real with GSCORE_DATA set); a network:
# EXPERIMENT="--model FILE.onnx".
experiment-depth: $(LIBRARY)  ## with and without depth, from 6 to 50 views: out/experiment-depth/
	$(BIN)/python -m experiments.depth $(EXPERIMENT)

docs: $(DEVELOPED) $(LIBRARY)  ## the API reference into out/docs/index.html; a warning is an error
	$(BIN)/sphinx-build -q -W --keep-going -b html docs/api out/docs

wheel: $(INSTALLED)  ## gscore's wheel into dist/
	$(BIN)/python -m pip wheel -qq --no-deps --wheel-dir dist .

clean:  ## removes what the other targets made
	rm -rf build dist out $(VENV) .venv-blender .venv-zig gscore/raster/libgscore.* gscore/raster/gscore.dll
