"""One suite that every scanner driver passes, ours and third parties'.

``python -m amr_drivers.conformance`` runs it. A rig puts a driver in front of its emulator
(:mod:`.rig`); scenarios let the device fail and compare what the driver says with the truth.
"""
