//! Materials of a Mitsuba file.

use super::{Element, MitsubaScene, Reader, child_elements, property_element};
use crate::material::{self, Material};
use crate::scene::room::{Finish, THICKEST};
use pwrfgs_core::messages::quoted;
use pwrfgs_core::{Result, did_you_mean};
use pwrfgs_data::warn_once;

/// Thickness of a material that states none, as in Sionna RT, metres.
const THICKNESS: f64 = 0.1;
/// Properties of radio materials in Sionna RT, the last three of scattering patterns.
const PROPERTIES: [&str; 11] = [
    "type",
    "relative_permittivity",
    "conductivity",
    "thickness",
    "scattering_coefficient",
    "xpd_coefficient",
    "scattering_pattern",
    "color",
    "alpha_r",
    "alpha_i",
    "lambda_",
];

impl<'a> Reader<'a> {
    /// Returns an error for a radio material with a texture, or a property that Sionna RT does not have.
    fn check_properties(&self, node: Element<'_>) -> Result<()> {
        for child in child_elements(node) {
            let problem = "unsupported texture: a radio material is constant over a mesh; split the mesh by material";
            self.require(!child.has_tag_name("texture"), child, problem)?;
            let name = self.required_attribute(child, "name")?;
            if !PROPERTIES.contains(&&*name) {
                let hint = did_you_mean(&name, PROPERTIES);
                let problem =
                    format!("unknown property {}{hint} of a radio material; correct or remove it", quoted(&name));
                return Err(self.fault(child, problem));
            }
        }
        Ok(())
    }

    /// Adds a `bsdf` element to `materials`, and reads a radio material; others are read when a shape uses them. Returns an
    /// error for a repeated id, or an invalid radio material.
    pub(super) fn declare_material(&mut self, node: Element<'a>, scene: &mut MitsubaScene) -> Result<()> {
        let Some(id) = self.attribute(node, "id")? else { return Ok(()) };
        let problem = format!("two materials have the id {}; rename one of them", quoted(&id));
        let other = self.materials.insert(id, node);
        self.require(other.is_none(), node, problem)?;
        let is_radio = node.attribute("type").is_some_and(|kind| kind.ends_with("radio-material"));
        if is_radio { self.finish_of(node, scene).map(drop) } else { Ok(()) }
    }

    /// Returns the finish of a `bsdf` element, which is read at its first use. Returns the errors of
    /// [`Self::read_material`].
    fn finish_of(&mut self, node: Element<'_>, scene: &mut MitsubaScene) -> Result<Finish> {
        let finish = self.attribute(node, "id")?.and_then(|id| self.finishes.get(&id).cloned());
        finish.map_or_else(|| self.read_material(node, scene), Ok)
    }

    /// Reads a `bsdf` element: adds its finish to `finishes`, and a material that states constants to `scene`. Returns
    /// an error unless it is a radio material or one of the scene file, and for an invalid property.
    fn read_material(&mut self, node: Element<'_>, scene: &mut MitsubaScene) -> Result<Finish> {
        let unnamed = || format!("material {}", self.finishes.len() + 1);
        let (id, kind) = (self.attribute(node, "id")?.unwrap_or_else(unnamed), self.required_attribute(node, "type")?);
        let shown = quoted(&id);
        // The exporter of Blender begins ids with `mat-`.
        let plain = id.strip_prefix("mat-").unwrap_or(&id);
        let itu = plain.strip_prefix("itu_").or_else(|| plain.strip_prefix("itu-"));
        let itu = itu.filter(|name| kind != "radio-material" || material::itu_material(name).is_some());
        let scene_material = [&*id, plain].into_iter().find(|name| self.scene_materials.contains(name));
        if ["radio-material", "itu-radio-material"].contains(&&*kind) {
            self.check_properties(node)?;
        }
        let material = if let Some(name) = scene_material {
            name.to_owned()
        } else if kind == "itu-radio-material" || itu.is_some() {
            if kind == "radio-material" {
                let reason =
                    "has the constants of ITU-R P.2040, as in Sionna RT, not those in the file; rename it to keep them";
                warn_once(self.path, format_args!("material {shown} {reason}"));
            }
            self.itu_name(node, itu)?
        } else {
            let problem = "is not a radio material; rename it to `itu_concrete` or another ITU material, set its type to \
                        `itu-radio-material`, or give its constants in `materials` of a scene file";
            let problem = format!("material {shown} of type {} {problem}", quoted(&kind));
            self.require(kind == "radio-material", node, problem)?;
            self.read_constants(node, &id, scene)?
        };
        if self.property_number(node, "xpd_coefficient", 0.0, 1.0)?.is_some_and(|xpd| xpd > 0.0) {
            tracing::warn!("{}: `xpd_coefficient` of material {shown} is ignored", self.path.display());
        }
        let thickness_m = Some(self.property_number(node, "thickness", 1e-6, THICKEST)?.unwrap_or(THICKNESS));
        let roughness = self.property_number(node, "scattering_coefficient", 0.0, 1.0)?;
        let finish = Finish { material, thickness_m, roughness };
        self.finishes.insert(id, finish.clone());
        Ok(finish)
    }

    /// Adds the material with the constants of the radio material `id` to `scene`, and returns its name. Returns an error for
    /// a constant out of range.
    fn read_constants(&self, node: Element<'_>, id: &str, scene: &mut MitsubaScene) -> Result<String> {
        // The limits are those of `output/mitsuba.rs`.
        let a = self.property_number(node, "relative_permittivity", 1.0, 1e6)?.unwrap_or(1.0);
        let c = self.property_number(node, "conductivity", 0.0, 1e12)?.unwrap_or(0.0);
        // A name of ITU-R P.2040 would replace that material in the whole scene.
        let is_taken = material::itu_material(id).is_some();
        let name = if is_taken { format!("{id} (radio-material)") } else { id.to_owned() };
        scene.materials.insert(name.clone(), Material { a, b: 0.0, c, d: 0.0, range_ghz: (0.0, f64::INFINITY) });
        Ok(name)
    }

    /// Returns the name of the ITU-R P.2040 material of a `bsdf` element: its property `type`, else the name in its id. Returns
    /// an error for an unknown name, or without one.
    fn itu_name(&self, node: Element<'_>, name_in_id: Option<&str>) -> Result<String> {
        let type_node = property_element(node, "type");
        let stated = type_node.map(|child| self.required_attribute(child, "value")).transpose()?;
        let name = stated.or(name_in_id.map(str::to_owned)).unwrap_or_default();
        let names = material::itu_material_names();
        if names.contains(&&*name) {
            return Ok(name);
        }
        let (hint, listed) = (did_you_mean(&name, names.iter().copied()), names.join(", "));
        let problem = format!("unknown ITU material {}{hint}; its `type` is one of {listed}", quoted(&name));
        Err(self.fault(type_node.unwrap_or(node), problem))
    }

    /// Reads the finish of a shape: inside it, which is also added to `scene`, or referenced. Returns an error if it is
    /// missing.
    pub(super) fn read_finish(&mut self, node: Element<'a>, scene: &mut MitsubaScene) -> Result<Finish> {
        if let Some(inner) = child_elements(node).find(|child| child.has_tag_name("bsdf")) {
            self.declare_material(inner, scene)?;
            return self.finish_of(inner, scene);
        }
        let is_bsdf = |child: &Element<'_>| child.attribute("name").is_none_or(|name| name == "bsdf");
        let reference = child_elements(node).filter(is_bsdf).find(|child| child.has_tag_name("ref"));
        let problem = "the shape has no material; add <ref id=\"..\" name=\"bsdf\"/> with the id of a `bsdf`";
        let reference = reference.ok_or_else(|| self.fault(node, problem))?;
        let id = self.required_attribute(reference, "id")?;
        let material = self.materials.get(&id).copied().ok_or_else(|| {
            let hint = did_you_mean(&id, self.materials.keys().map(String::as_str));
            self.fault(reference, format!("unknown material {}{hint}; add a `bsdf` with this id", quoted(&id)))
        })?;
        self.finish_of(material, scene)
    }
}
