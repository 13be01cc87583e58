"""Faults on purpose: kills, full disks, damaged files, damaged inputs. Every case must end whole or in one line."""
