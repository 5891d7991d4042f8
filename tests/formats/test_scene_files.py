"""A scene reopened by USD and by MuJoCo: the same poses, masses, frictions and points."""

import resource
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from dexnudge.errors import InputError, OutputError, UnknownNameError
from dexnudge.formats.conversion import FORMATS, convert
from dexnudge.formats.scene_files import write_mujoco, write_usd

FLOAT = 1e-7  # USD's points are in single precision


def matrix(prim):
    from pxr import Usd, UsdGeom

    return np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())).T


@pytest.mark.parametrize("suffix", [".usda", ".usdc"])
def test_usd_has_the_same_scene(suffix, box_scene, box_samples, tmp_path):
    from pxr import Usd, UsdGeom, UsdPhysics, UsdShade

    hand, q = box_samples.hand, box_samples.q[0]
    write_usd(box_scene, tmp_path / f"s{suffix}", hand=hand, q=q)
    stage = Usd.Stage.Open(str(tmp_path / f"s{suffix}"))
    assert (UsdGeom.GetStageMetersPerUnit(stage), UsdGeom.GetStageUpAxis(stage)) == (1.0, "Z")
    thing = stage.GetPrimAtPath("/World/object")
    assert np.allclose(matrix(thing), box_scene.T_world_object, rtol=0, atol=1e-12)
    assert thing.HasAPI(UsdPhysics.RigidBodyAPI)
    assert UsdPhysics.MassAPI(thing).GetMassAttr().Get() == pytest.approx(box_scene.mass)
    table = stage.GetPrimAtPath("/World/environment")
    assert not table.HasAPI(UsdPhysics.RigidBodyAPI)
    for prim, mesh in ((thing, box_scene.object_mesh), (table, box_scene.environment_mesh)):
        shape = UsdGeom.Mesh(stage.GetPrimAtPath(prim.GetPath().AppendChild("mesh")))
        assert np.allclose(np.array(shape.GetPointsAttr().Get()), mesh.vertices, rtol=0, atol=FLOAT)
        assert np.array_equal(np.array(shape.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3), mesh.faces)
        assert shape.GetPrim().HasAPI(UsdPhysics.CollisionAPI)
    poses = hand.forward_kinematics(torch.as_tensor(q[None]))[0].numpy()
    frictions = {}
    for place in ("object", f"hand/{hand.link_names[0]}"):
        shape = stage.GetPrimAtPath(f"/World/{place}/mesh")
        material, _ = UsdShade.MaterialBindingAPI(shape).ComputeBoundMaterial("physics")
        frictions[place] = UsdPhysics.MaterialAPI(material).GetDynamicFrictionAttr().Get()
    assert frictions["object"] == pytest.approx(box_scene.friction_environment)
    assert np.mean(list(frictions.values())) == pytest.approx(box_scene.friction_hand)  # USD averages the two
    links = stage.GetPrimAtPath("/World/hand").GetChildren()
    assert [link.GetName() for link in links] == list(hand.link_names)
    for link, pose in zip(links, poses, strict=True):
        assert UsdPhysics.RigidBodyAPI(link).GetKinematicEnabledAttr().Get()
        assert np.allclose(matrix(link), pose, rtol=0, atol=1e-12)


def test_links_whose_names_usd_does_not_allow_are_all_there(box_scene, box_samples, tmp_path):
    from pxr import Usd

    palm, first, second, *others = box_samples.hand.link_names
    new = {palm: "0 palm", first: "a.b", second: "a-b"}
    tips = {digit: new.get(link, link) for digit, link in box_samples.hand.fingertips.items()}
    hand = replace(box_samples.hand, link_names=(*new.values(), *others), fingertips=tips)
    write_usd(box_scene, tmp_path / "s.usda", hand=hand, q=box_samples.q[0])
    stage = Usd.Stage.Open(str(tmp_path / "s.usda"))
    links = stage.GetPrimAtPath("/World/hand").GetChildren()
    assert [link.GetName() for link in links] == ["__palm", "a_b", "a_b_02", *others]
    assert [link.GetDisplayName() for link in links] == list(hand.link_names)


def test_usd_has_a_scene_without_a_hand(box_scene, tmp_path):
    from pxr import Usd

    write_usd(box_scene, tmp_path / "s.usda")
    assert not Usd.Stage.Open(str(tmp_path / "s.usda")).GetPrimAtPath("/World/hand")
    with pytest.raises(InputError, match=r"expected \.usda"):
        write_usd(box_scene, tmp_path / "s.obj")


def test_mujoco_has_the_same_scene_with_a_key_for_each_configuration(box_scene, box_samples, tmp_path):
    write_mujoco(box_scene, tmp_path / "s.xml", hand=box_samples.hand, q=box_samples.q[:2])
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "s.xml"))
    data = mujoco.MjData(model)
    assert model.body("pushed object").mass[0] == pytest.approx(box_scene.mass)
    assert model.nkey == 2
    poses = box_samples.hand.forward_kinematics(torch.as_tensor(box_samples.q[:2])).numpy()
    for key in range(2):
        mujoco.mj_resetDataKeyframe(model, data, key)
        mujoco.mj_forward(model, data)
        assert np.allclose(data.body("pushed object").xpos, box_scene.T_world_object[:3, 3], atol=1e-8)
        assert np.allclose(data.body("pushed object").xmat.reshape(3, 3), box_scene.T_world_object[:3, :3], atol=1e-8)
        for link, name in enumerate(box_samples.hand.link_names):
            assert np.allclose(data.body(name).xpos, poses[key, link, :3, 3], atol=1e-7)


def test_mujoco_has_a_scene_without_a_hand(box_scene, tmp_path):
    write_mujoco(box_scene, tmp_path / "s.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "s.xml"))
    assert np.allclose(model.body("pushed object").pos, box_scene.T_world_object[:3, 3])


def test_conversions_that_cannot_be_are_told(box_scene, tmp_path):
    box_scene.save(tmp_path / "scene")
    with pytest.raises(UnknownNameError, match=f"did you mean 'usd'.*{FORMATS[0]}"):
        convert(tmp_path / "scene", "usda", tmp_path / "out")
    with pytest.raises(InputError, match=r"holds no configurations\.npz"):
        convert(tmp_path / "scene", "bodex", tmp_path / "out")
    with pytest.raises(InputError, match=r"holds no episode\.npz"):
        convert(tmp_path / "scene", "lerobot", tmp_path / "out")
    with pytest.raises(InputError, match="is not a folder"):
        convert(tmp_path / "none", "usd", tmp_path / "out.usda")
    assert convert(tmp_path / "scene", "usd", tmp_path / "out.usda") == "the scene"
    with pytest.raises(OutputError, match="exists"):
        convert(tmp_path / "scene", "usd", tmp_path / "out.usda")


@pytest.mark.parametrize("name", ["s.usda", "s.usdc", "s.xml"])
def test_a_full_disk_leaves_nothing(name, box_scene, tmp_path):
    box_scene.save(tmp_path / "scene")
    to, limits = "mujoco" if name == "s.xml" else "usd", resource.getrlimit(resource.RLIMIT_FSIZE)
    (tmp_path / "out").mkdir()
    resource.setrlimit(resource.RLIMIT_FSIZE, (500, limits[1]))
    try:
        with pytest.raises(OutputError, match=f"cannot write .*{name}"):
            convert(tmp_path / "scene", to, tmp_path / "out" / name)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert not list((tmp_path / "out").iterdir())
