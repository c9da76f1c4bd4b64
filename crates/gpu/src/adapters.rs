//! GPUs of the machine, and the one of the process.

use crate::shaders::{DRAWING, DRAWING_SOURCE, NETWORKS_SOURCE, RESIDENT, RESIDENT_SOURCE};
use crate::workspace::Workspace;
use crate::{MOST_ROWS, SLICE};
use pwrfgs_core::device::{self, DeviceChoice};
use pwrfgs_core::{Error, Result};
use std::future::Future;
use std::pin::pin;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::task::{Context, Poll, Waker};
use wgpu::{Adapter, Backends, DeviceType, InstanceDescriptor};

/// Environment variable that admits software adapters, for tests.
const SOFTWARE: &str = "PWRFGS_DEVICE_SOFTWARE";

/// Environment variable that limits the memory of the GPU, MB: for tests, and for shared GPUs.
const MEMORY: &str = "PWRFGS_DEVICE_MEMORY";

/// GPU of the process: device, queue, kernels, and buffers that steps reuse.
#[derive(Debug)]
pub struct Gpu {
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    pub(crate) layout: wgpu::BindGroupLayout,
    /// Pipelines in the order of [`KERNELS`], then of [`DRAWING`] and [`RESIDENT`].
    pub(crate) kernels: Vec<wgpu::ComputePipeline>,
    /// Maximum size of a buffer, bytes.
    pub(crate) most_bytes: u64,
    /// Maximum number of bytes that a step may use.
    pub(crate) memory: u64,
    /// Buffers of networks.
    pub(crate) workspace: Mutex<Workspace>,
    /// Buffers of drawings.
    pub(crate) drawings: Mutex<Workspace>,
    /// Buffers of whole training steps.
    pub(crate) training: Mutex<Workspace>,
    /// First error since the last check, which the driver reports at any time.
    pub(crate) failure: Arc<Mutex<Option<String>>>,
    name: String,
}

/// Entry points of `kernels.wgsl`.
pub(crate) const KERNELS: [&str; 7] =
    ["product", "sum_planes", "sum_rows", "bias_relu", "add", "amplitudes_vjp", "encode_vjp"];

/// GPU of the machine, as `pwrfgs devices` lists it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GpuLine {
    /// Name, with interface and driver: `NVIDIA H100 (Vulkan, 580.159)`.
    pub name: String,
    /// Whether it is a program on the CPU, which `--device` refuses.
    pub is_software: bool,
}

/// Returns the result of a future of wgpu, which needs no executor.
pub(crate) fn wait_for<T>(future: impl Future<Output = T>) -> T {
    let (mut future, mut context) = (pin!(future), Context::from_waker(Waker::noop()));
    loop {
        match future.as_mut().poll(&mut context) {
            Poll::Ready(result) => return result,
            Poll::Pending => std::thread::yield_now(),
        }
    }
}

/// Returns the adapters of the machine, in the order of their numbers: discrete GPUs first.
pub(crate) fn adapters() -> Vec<Adapter> {
    let instance = wgpu::Instance::new(InstanceDescriptor {
        backends: Backends::PRIMARY,
        memory_budget_thresholds: wgpu::MemoryBudgetThresholds {
            for_resource_creation: Some(97), // percent; beyond it an error, instead of memory of the CPU, which is slow
            for_device_loss: None,
        },
        ..InstanceDescriptor::new_without_display_handle()
    });
    let mut adapters = wait_for(instance.enumerate_adapters(Backends::PRIMARY));
    adapters.sort_by_key(|adapter| match adapter.get_info().device_type {
        DeviceType::DiscreteGpu => 0,
        DeviceType::VirtualGpu => 1,
        DeviceType::IntegratedGpu => 2,
        DeviceType::Other => 3,
        DeviceType::Cpu => 4,
    });
    adapters
}

/// Creates the line of an adapter in the list of GPUs.
fn create_line(adapter: &Adapter) -> GpuLine {
    let info = adapter.get_info();
    let backend = format!("{:?}", info.backend);
    let driver = if info.driver_info.is_empty() { &info.driver } else { &info.driver_info };
    let details: Vec<&str> = [&*backend, driver].into_iter().filter(|part| !part.is_empty()).collect();
    let name = format!("{} ({})", info.name, details.join(", "));
    GpuLine { name, is_software: info.device_type == DeviceType::Cpu }
}

/// Returns the GPUs of the machine; their numbers are their indices.
pub fn list() -> Vec<GpuLine> {
    adapters().iter().map(create_line).collect()
}

static CURRENT: OnceLock<Gpu> = OnceLock::new();

/// Returns the GPU of the process; `None` if it computes on the CPU. After the first call the device cannot change.
pub fn current() -> Option<&'static Gpu> {
    device::name().and_then(|_| CURRENT.get())
}

/// Returns a GPU for tests, a software adapter if there is no other. Without one it returns `None` and reports the test as
/// skipped. It is not the GPU of the process.
pub fn for_tests() -> Option<&'static Gpu> {
    static GPU: OnceLock<Option<Gpu>> = OnceLock::new();
    let gpu = GPU.get_or_init(|| adapters().first().and_then(|adapter| Gpu::open(adapter).ok()));
    if gpu.is_none() {
        pwrfgs_core::testing::skipped("no GPU here, nor Debian's mesa-vulkan-drivers and libvulkan1");
    }
    gpu.as_ref()
}

/// Selects a GPU for the process; the CPU if `choice` is the CPU, or is automatic and there is no GPU.
///
/// # Errors
/// [`Error::Config`] if there is no such GPU, or it is a software adapter and `PWRFGS_DEVICE_SOFTWARE` is not 1, or the process
/// computes on another device. [`Error::Device`] if the driver cannot open the GPU.
pub fn select(choice: DeviceChoice) -> Result<()> {
    let refuse = || {
        let used = CURRENT.get().map_or("the CPU", Gpu::name);
        Err(Error::Config(format!(
            "--device {choice}: this process computes on {used}; select the device before the first computation"
        )))
    };
    if choice == DeviceChoice::Cpu {
        return if CURRENT.get().is_some() { refuse() } else { Ok(()) };
    }
    let adapters = adapters();
    let admits_software = std::env::var_os(SOFTWARE).is_some_and(|value| value == "1");
    let lines: Vec<GpuLine> = adapters.iter().map(create_line).collect();
    let index = match pick(choice, &lines, admits_software) {
        Ok(Some(index)) => index,
        Ok(None) => return Ok(()),
        Err(why) => return Err(Error::Config(format!("--device {choice}: {why}"))),
    };
    let name = &lines[index].name;
    if let Some(gpu) = CURRENT.get() {
        return if gpu.name == *name { Ok(()) } else { refuse() };
    }
    let gpu = Gpu::open(&adapters[index]).map_err(|why| Error::Device(format!("{name}: {why}")))?;
    if !device::set_name(name) {
        return refuse();
    }
    CURRENT.get_or_init(|| gpu);
    Ok(())
}

/// Returns the index of the chosen GPU in `lines`; `None` for the CPU, also if the choice is automatic and no GPU is usable.
/// The error says why there is no such GPU.
pub(crate) fn pick(choice: DeviceChoice, lines: &[GpuLine], admits_software: bool) -> Result<Option<usize>, String> {
    let only_software = |name: &str| {
        let short = name.split(" (").next().unwrap_or(name);
        format!("only {short}, a software GPU slower than the CPU, was found")
    };
    let is_usable = |line: &GpuLine| admits_software || !line.is_software;
    let first = lines.iter().position(is_usable);
    match choice {
        DeviceChoice::Cpu => Ok(None),
        DeviceChoice::Auto => Ok(first),
        DeviceChoice::Gpu => match (first, lines.first()) {
            (Some(first), _) => Ok(Some(first)),
            (None, Some(line)) => Err(only_software(&line.name)),
            (None, None) => {
                Err("no GPU found (Vulkan, Metal, DX12); install a driver, on a cluster set VK_DRIVER_FILES, or \
                                 leave --device out"
                    .to_owned())
            }
        },
        DeviceChoice::Number(number) => match lines.get(number) {
            Some(line) if is_usable(line) => Ok(Some(number)),
            Some(line) => Err(format!("{} is a software GPU slower than the CPU; see `pwrfgs devices`", line.name)),
            None => Err(format!(
                "{} found; see `pwrfgs devices`",
                match lines.len() {
                    0 => "no GPU was".to_owned(),
                    1 => "one GPU, number 0, was".to_owned(),
                    n => format!("GPUs 0 to {} were", n - 1),
                }
            )),
        },
    }
}

/// Keeps the reason `why` of a failure, if it is the first since the last check.
pub(crate) fn keep_first(failure: &Mutex<Option<String>>, why: String) {
    failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(why);
}

/// Installs handlers that keep the first failure of the device; without them wgpu ends the process.
fn watch_failures(device: &wgpu::Device) -> Arc<Mutex<Option<String>>> {
    let failure = Arc::new(Mutex::new(None));
    let (other, lost) = (Arc::clone(&failure), Arc::clone(&failure));
    device.on_uncaptured_error(Arc::new(move |e: wgpu::Error| keep_first(&other, e.to_string())));
    device.set_device_lost_callback(move |reason, message| {
        if reason != wgpu::DeviceLostReason::Destroyed {
            let message = message.trim();
            keep_first(&lost, format!("the GPU was lost ({message}); repeat the command to resume a run"));
        }
    });
    failure
}

/// Creates the layout of the bindings of all kernels: arguments, four inputs, and the output, as in `bindings.wgsl`.
fn create_bind_group_layout(device: &wgpu::Device) -> wgpu::BindGroupLayout {
    let storage = |read_only| wgpu::BufferBindingType::Storage { read_only };
    let entry = |binding, ty, has_dynamic_offset| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset, min_binding_size: None },
        count: None,
    };
    let mut entries = vec![entry(0, wgpu::BufferBindingType::Uniform, true)];
    entries.extend((1..=5).map(|binding| entry(binding, storage(binding < 5), false)));
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: None, entries: &entries })
}

/// Compiles [`KERNELS`], then [`DRAWING`] and [`RESIDENT`].
fn compile_kernels(device: &wgpu::Device, layout: &wgpu::BindGroupLayout) -> Vec<wgpu::ComputePipeline> {
    let modules = [NETWORKS_SOURCE, DRAWING_SOURCE, RESIDENT_SOURCE].map(|source| {
        let source = wgpu::ShaderSource::Wgsl(source.into());
        device.create_shader_module(wgpu::ShaderModuleDescriptor { label: None, source })
    });
    let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: None,
        bind_group_layouts: &[Some(layout)],
        immediate_size: 0,
    });
    let kernel = |(name, module): (&str, &wgpu::ShaderModule)| {
        device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(name),
            layout: Some(&pipeline_layout),
            module,
            entry_point: Some(name),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        })
    };
    let names: [&[&str]; 3] = [&KERNELS, &DRAWING, &RESIDENT];
    let entries =
        names.into_iter().zip(&modules).flat_map(|(names, module)| names.iter().map(move |name| (*name, module)));
    entries.map(kernel).collect()
}

impl Gpu {
    /// Opens an adapter and compiles the kernels; the error is that of the driver. Reads [`MEMORY`], and ignores text that is no
    /// number.
    pub(crate) fn open(adapter: &Adapter) -> Result<Self, String> {
        let limits = adapter.limits();
        let request = wgpu::DeviceDescriptor { required_limits: limits.clone(), ..Default::default() };
        let (device, queue) = wait_for(adapter.request_device(&request)).map_err(|e| e.to_string())?;
        let failure = watch_failures(&device);
        let layout = create_bind_group_layout(&device);
        let kernels = compile_kernels(&device, &layout);
        let most_bytes = limits.max_buffer_size.min(limits.max_storage_buffer_binding_size);
        let [workspace, drawings, training] = [(); 3].map(|()| Mutex::default());
        let name = create_line(adapter).name;
        let megabytes = std::env::var(MEMORY).ok().and_then(|text| text.parse::<u64>().ok());
        let memory = megabytes.map_or(u64::MAX, |megabytes| megabytes << 20);
        Ok(Self { device, queue, layout, kernels, most_bytes, memory, workspace, drawings, training, failure, name })
    }

    /// Returns the name, with interface and driver.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the number of rows per chunk, if a row has up to `width` numbers: a multiple of [`SLICE`] up to 65,536. A buffer
    /// of the chunk fits the GPU if [`SLICE`] rows do.
    pub fn chunk_rows(&self, width: usize) -> usize {
        let rows = self.most_bytes as usize / (size_of::<f32>() * width.max(1)) / SLICE * SLICE;
        rows.clamp(SLICE, MOST_ROWS)
    }
}
