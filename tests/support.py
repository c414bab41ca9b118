"""Robots that many tests share."""

BUILTIN = ("arm4", "denso_vp6242", "iiwa14", "kr210", "panda", "puma560", "ur5e")

# A tree with a branch, fixed links, a slide, a skew axis that is no unit vector, a continuous joint that is followed
# by two mimic joints (one of them through the other), and a mimic joint whose master is on another branch.
ZOO = """<?xml version="1.0"?>
<robot name="zoo">
  <link name="world"/><link name="base"/><link name="a"/><link name="b"/><link name="b2"/><link name="c"/>
  <link name="d"/><link name="e"/><link name="hand"/><link name="finger"/>
  <joint name="mount" type="fixed"><parent link="world"/><child link="base"/><origin xyz="0.1 0.2 0.3" rpy="0.3 -0.2 0.9"/></joint>
  <joint name="turn" type="continuous"><parent link="base"/><child link="a"/><origin xyz="0 0 0.4" rpy="0.1 0 0"/><axis xyz="1 2 2"/></joint>
  <joint name="slide" type="prismatic"><parent link="a"/><child link="b"/><origin xyz="0.2 0 0" rpy="0 0.5 0"/><axis xyz="0 -0.6 0.8"/><limit lower="-0.1" upper="0.5" effort="1" velocity="1"/></joint>
  <joint name="plate" type="fixed"><parent link="b"/><child link="b2"/><origin xyz="0 0.05 0" rpy="0 0 0.7"/></joint>
  <joint name="follow" type="revolute"><parent link="b2"/><child link="c"/><origin xyz="0 0 0.3"/><mimic joint="turn" multiplier="-0.5" offset="0.25"/><limit lower="-9" upper="9" effort="1" velocity="1"/></joint>
  <joint name="again" type="revolute"><parent link="c"/><child link="d"/><origin xyz="0 0.2 0.1" rpy="-1 0 0"/><axis xyz="0 1 0"/><mimic joint="follow" multiplier="2"/><limit lower="-9" upper="9" effort="1" velocity="1"/></joint>
  <joint name="wrist" type="revolute"><parent link="d"/><child link="e"/><origin xyz="0 0 0.2"/><axis xyz="0 0 -1"/><limit lower="-2" upper="1.5" effort="1" velocity="1"/></joint>
  <joint name="grip" type="fixed"><parent link="e"/><child link="hand"/><origin xyz="0 0 0.1" rpy="0 1.5707963267948966 0"/></joint>
  <joint name="finger_joint" type="prismatic"><parent link="b2"/><child link="finger"/><origin xyz="0 0.1 0"/><axis xyz="0 1 0"/><mimic joint="wrist" multiplier="0.01" offset="0.02"/><limit lower="0" upper="0.05" effort="1" velocity="1"/></joint>
</robot>
"""  # noqa: E501
