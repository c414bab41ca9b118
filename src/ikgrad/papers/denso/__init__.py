"""Almusawi, Duelger and Kapucu (2016): IK of the Denso VP6242 by a network that also sees the current joints."""
