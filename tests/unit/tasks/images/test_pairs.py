from types import SimpleNamespace

from solmap.tasks.images.pairs import camera_set


def test_each_side_of_curiosity_has_a_stereo_rig_of_its_own():
    names = {
        "NLA_399620372ARMLD0030266TRAV00004M1": "NAVCAM A",
        "NLB_517261274EDR_F0541610CCAM15900M1": "NAVCAM B",
        "2N292280938EFFB100P0703L0M1": "NAVCAM",
    }
    for name, cameras in names.items():
        assert camera_set(SimpleNamespace(id=name, instrument="NAVCAM")) == cameras
