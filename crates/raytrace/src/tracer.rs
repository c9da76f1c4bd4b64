//! Tracer: all paths from a transmitter to a receiver.

use crate::Complex;
use crate::array::Element;
use crate::fresnel::Polarized;
use crate::images::{ImageTree, Orders};
use crate::patches::{Patch, scattering_patches};
use crate::path::{Interaction, PropagationPath};
use crate::scattering::patch_amplitude;
use crate::scene::{Propagation, SceneFile, SceneReceiver};
use crate::waves::Ray;
use crate::world::{Edge, World};
use crate::{diffraction, fresnel};
use glam::{DMat3, DVec3};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

/// Field relative to free space below which a path is dropped.
const NEGLIGIBLE: f64 = 1e-8;
/// Distance from an edge at which its faces are probed, metres.
const BESIDE: f64 = 1e-3;
/// Sine of the angle between a ray and an edge below which the ray runs along the edge.
const ALONG: f64 = 1e-6;

/// Antenna with pattern and orientation.
#[derive(Debug)]
struct Antenna {
    /// Element pattern.
    element: Element,
    /// Polarisation axis in the antenna frame.
    axis: DVec3,
    /// Rotation from the antenna frame to the world frame.
    world_from_local: DMat3,
}

impl Antenna {
    /// Returns the field, world frame, radiated towards or received from the unit vector `direction`.
    fn field_towards(&self, direction: DVec3) -> DVec3 {
        let local = self.world_from_local.transpose() * direction;
        let (amplitude, field) = self.element.response(self.axis, local);
        self.world_from_local * field * amplitude
    }
}

/// Precomputed data of a receiver, independent of the transmitter.
#[derive(Debug)]
pub struct Tracer {
    world: Arc<World>,
    wavelength: f64,
    transmitter: Antenna,
    receiver: Antenna,
    tree: ImageTree,
    propagation: Propagation,
    /// Patches visible from the receiver.
    patches: Vec<Patch>,
}

impl Tracer {
    /// Creates a tracer to `position`, metres, world frame: an antenna of `receiver` or the centre of its array. `None` if
    /// the image tree would grow too large.
    pub fn new(world: &Arc<World>, scene: &SceneFile, receiver: &SceneReceiver, position: DVec3) -> Option<Self> {
        let (world, propagation) = (Arc::clone(world), Propagation::clone(&scene.propagation));
        let orders = Orders { all: propagation.order, room: propagation.room_order };
        let tree = ImageTree::build(&world, position, orders)?;
        let mut sheets = Vec::new();
        let mut patches = scattering_patches(&world, propagation.patch_m, propagation.seed);
        patches.retain(|patch| {
            world.collect_sheets(patch.point, position, [&[patch.face], &[]], &mut sheets)
                && (propagation.transmission || sheets.is_empty())
        });
        let transmitter = Antenna {
            element: scene.transmitter.element.clone(),
            axis: DVec3::from(scene.transmitter.polarization).normalize(),
            world_from_local: DMat3::IDENTITY,
        };
        let receiver = Antenna {
            element: receiver.array.element.clone(),
            axis: DVec3::from(receiver.array.polarization).normalize(),
            world_from_local: receiver.world_from_receiver(),
        };
        Some(Self { world, wavelength: scene.wavelength(), transmitter, receiver, tree, propagation, patches })
    }

    /// Returns the approximate memory use, bytes.
    pub fn memory_bytes(&self) -> usize {
        self.tree.memory_bytes() + self.patches.len() * size_of::<Patch>()
    }

    /// Returns all paths from `tx`, metres, world frame: specular by image order, then diffracted, then scattered.
    pub fn trace(&self, tx: DVec3) -> Vec<PropagationPath> {
        let mut walk =
            TraceWalk { tracer: self, tx, rx: self.tree.origin(), sheets: Vec::new(), interactions: Vec::new() };
        let mut paths = Vec::new();
        self.tree.visit_candidates(&self.world, tx, |faces, points| paths.extend(walk.specular_path(faces, points)));
        if self.propagation.diffraction {
            paths.extend(
                self.world.edges.iter().enumerate().filter_map(|(i, edge)| walk.diffracted_path(i as u32, edge)),
            );
        }
        paths.extend(self.patches.iter().filter_map(|patch| walk.scattered_path(patch)));
        paths
    }

    /// Returns the amplitude between isotropic antennas at 1 m, λ/4π.
    fn unit_gain(&self) -> f64 {
        self.wavelength / (4.0 * PI)
    }
}

/// Traversal of the candidates of one transmitter, with reused buffers.
struct TraceWalk<'a> {
    tracer: &'a Tracer,
    tx: DVec3,
    rx: DVec3,
    sheets: Vec<(f64, u32)>,
    interactions: Vec<Interaction>,
}

impl TraceWalk<'_> {
    /// Returns the ray after the straight segment from `from` to `to`, and adds the sheets on it to the interactions;
    /// `None` if it is blocked or negligible. `ends` has the faces on which each end lies.
    fn propagate(&mut self, ray: Ray, [from, to]: [DVec3; 2], ends: [&[u32]; 2]) -> Option<Ray> {
        let Self { tracer, sheets, interactions, .. } = self;
        if !tracer.world.collect_sheets(from, to, ends, sheets)
            || !(tracer.propagation.transmission || sheets.is_empty())
        {
            return None;
        }
        let through = |ray: Ray, &(position, face): &(f64, u32)| {
            interactions.push(Interaction::Transmission { face, point: from.lerp(to, position) });
            let normal = tracer.world.faces[face as usize].normal;
            ray.transmitted(tracer.world.surface_of(face), normal, tracer.wavelength)
        };
        let ray = sheets.iter().try_fold(ray, through)?;
        (ray.power() > NEGLIGIBLE * NEGLIGIBLE).then_some(ray)
    }

    /// Begins a path: clears the interactions, and returns the ray that leaves the transmitter towards `to`; `None` if
    /// `to` is the transmitter position.
    fn emit_ray(&mut self, to: DVec3) -> Option<Ray> {
        self.interactions.clear();
        let direction = (to - self.tx).try_normalize()?;
        Some(Ray::new(direction, self.tracer.transmitter.field_towards(direction)))
    }

    /// Returns the path that ends with `ray` at the receiver; `gain` is its spreading factor. `source` and `before` as in
    /// [`PropagationPath`].
    fn finish_path(&self, ray: Ray, gain: f64, departure: DVec3, (source, before): (DVec3, f64)) -> PropagationPath {
        let arrival = -ray.direction;
        let field = self.tracer.receiver.field_towards(arrival);
        PropagationPath {
            gain: gain * ray.component(field),
            length: before + self.rx.distance(source),
            departure,
            arrival,
            source,
            before,
            interactions: self.interactions.clone(),
        }
    }

    /// Returns the path that reflects at `points` on `faces`, in order of travel; `None` if it is blocked or negligible.
    fn specular_path(&mut self, faces: &[u32], points: &[DVec3]) -> Option<PropagationPath> {
        let tracer = self.tracer;
        let first = points.first().copied().unwrap_or(self.rx);
        let mut ray = self.emit_ray(first)?;
        let (departure, mut from, mut source) = (ray.direction, self.tx, self.tx);
        let mut start_face: &[u32] = &[];
        for (end_face, &point) in faces.chunks(1).zip(points) {
            let face = end_face[0];
            if tracer.world.front_face(face, point, from) != face {
                return None;
            }
            ray = self.propagate(ray, [from, point], [start_face, end_face])?;
            let plane = &tracer.world.faces[face as usize];
            self.interactions.push(Interaction::Reflection { face, point });
            ray = ray.reflected(tracer.world.surface_of(face), plane.normal, tracer.wavelength);
            (from, start_face, source) = (point, end_face, plane.mirror(source));
        }
        ray = self.propagate(ray, [from, self.rx], [start_face, &[]])?;
        let gain = tracer.unit_gain() / self.rx.distance(source);
        Some(self.finish_path(ray, gain, departure, (source, 0.0)))
    }

    /// Returns the path that diffracts at `edge`, which has this `index`; `None` if it misses the edge, is blocked or
    /// negligible, or [`Self::edge_coefficients`] has none.
    fn diffracted_path(&mut self, index: u32, edge: &Edge) -> Option<PropagationPath> {
        let tracer = self.tracer;
        let [a, b] = edge.ends;
        let t = diffraction::edge_parameter(a, b, self.tx, self.rx);
        if !(t > 0.0 && t < 1.0) {
            return None;
        }
        let point = a.lerp(b, t);
        let coefficients = self.edge_coefficients(edge, point)?;
        let ray = self.emit_ray(point)?;
        let departure = ray.direction;
        let ray = self.propagate(ray, [self.tx, point], [&[], &edge.faces])?;
        self.interactions.push(Interaction::Diffraction { edge: index, point });
        let out = (self.rx - point).try_normalize()?;
        let ray = ray.diffracted((b - a).normalize(), out, &coefficients);
        let ray = self.propagate(ray, [point, self.rx], [&edge.faces, &[]])?;
        let (before, after) = (self.tx.distance(point), self.rx.distance(point));
        let gain = tracer.unit_gain() / (before * after * (before + after)).sqrt();
        Some(self.finish_path(ray, gain, departure, (point, before)))
    }

    /// Returns the diffraction coefficients at a point of an edge, √m; `None` if transmitter or receiver is inside the
    /// wedge or on the line of the edge.
    fn edge_coefficients(&self, edge: &Edge, point: DVec3) -> Option<Polarized> {
        let direction = (edge.ends[1] - edge.ends[0]).normalize();
        let angle = |to: DVec3| {
            let angle = to.dot(edge.normal).atan2(to.dot(edge.along));
            if angle < 0.0 { angle + TAU } else { angle }
        };
        let (to_tx, to_rx) = (self.tx - point, self.rx - point);
        let (phi_in, phi_out) = (angle(to_tx), angle(to_rx));
        let sine = direction.cross(to_tx).length() / to_tx.length();
        let outer_angle = edge.outer_angle * PI;
        if phi_in >= outer_angle || phi_out >= outer_angle || sine < ALONG {
            return None;
        }
        // The smaller of the two angles on either face: exact at reflection boundaries and reciprocal (El-Sallabi and
        // Vainikainen, 2005).
        let cosine = |grazing: f64| (grazing.sin() * sine).abs();
        let beside = edge.inward_directions().map(|inwards| point + BESIDE * inwards);
        let (r0, t0) = self.face_coefficients(edge.faces[0], beside[0], cosine(phi_in.min(phi_out)));
        let (rn, tn) = self.face_coefficients(edge.faces[1], beside[1], cosine(outer_angle - phi_in.max(phi_out)));
        // The rim of a sheet has one sheet behind it, an edge of two faces has both.
        let is_rim = edge.faces[0] == edge.faces[1];
        let through = if is_rim { t0 } else { t0.times(tn) };
        let wedge = diffraction::Wedge { n: edge.outer_angle, r0, rn, through };
        let (k, distances) = (TAU / self.tracer.wavelength, [to_tx.length(), to_rx.length()]);
        Some(wedge.diffraction_coefficients(k, distances, [phi_in, phi_out], sine))
    }

    /// Returns the reflection and transmission coefficients of a face of an edge at the point `beside` the edge, metres. If
    /// another face covers it there, that one reflects, and waves pass both. `cosine` is that of the angle of incidence.
    fn face_coefficients(&self, face: u32, beside: DVec3, cosine: f64) -> (Polarized, Polarized) {
        let Tracer { world, wavelength, .. } = self.tracer;
        let front = world.front_face(face, beside, self.tx);
        let through = |face: u32| {
            let surface = world.surface_of(face);
            let slab = |d| fresnel::transmission(surface.eta, d, cosine, *wavelength);
            surface.thickness.map_or(Polarized::NOTHING, slab)
        };
        let surface = world.surface_of(front);
        let reflected = fresnel::reflection(surface.eta, surface.thickness, cosine, *wavelength);
        let alone = through(face);
        (reflected, if front == face { alone } else { alone.times(through(front)) })
    }

    /// Returns the path that scatters at `patch`; `None` if it is blocked or negligible, or transmitter and receiver are on
    /// different sides of the patch.
    fn scattered_path(&mut self, patch: &Patch) -> Option<PropagationPath> {
        let tracer = self.tracer;
        let surface = tracer.world.surface_of(patch.face);
        let normal = tracer.world.faces[patch.face as usize].normal;
        let (to_tx, to_rx) = (self.tx - patch.point, self.rx - patch.point);
        let out = to_rx.try_normalize()?;
        let ray = self.emit_ray(patch.point)?;
        let (departure, cos_in, cos_out) = (ray.direction, -ray.direction.dot(normal), out.dot(normal));
        if cos_in * cos_out <= 0.0 {
            return None; // it scatters back to the side that the wave came from
        }
        if tracer.world.front_face(patch.face, patch.point, self.tx) != patch.face {
            return None;
        }
        let ray = self.propagate(ray, [self.tx, patch.point], [&[], &[patch.face]])?;
        let r = fresnel::reflection(surface.eta, surface.thickness, cos_in.abs(), tracer.wavelength);
        let reflected = (0.5 * (r.te.norm_sqr() + r.tm.norm_sqr())).sqrt();
        let specular = departure - 2.0 * departure.dot(normal) * normal;
        let density = surface.lobe.density(cos_in.abs(), cos_out.abs(), specular.dot(out));
        let (before, after) = (to_tx.length(), to_rx.length());
        // At less than its radius a patch is no point source: the distance is clamped.
        let radius = (patch.area / PI).sqrt();
        let distances = (before.max(radius), after.max(radius));
        let (area, wavelength, roughness) = (patch.area, tracer.wavelength, surface.roughness);
        let gain = patch_amplitude(roughness, reflected, density, area, cos_in.abs(), distances, wavelength);
        self.interactions.push(Interaction::Scattering { face: patch.face, point: patch.point });
        let ray = ray.scattered(out, Complex::cis(patch.phase));
        let ray = self.propagate(ray, [patch.point, self.rx], [&[patch.face], &[]])?;
        Some(self.finish_path(ray, gain, departure, (patch.point, before)))
    }
}
