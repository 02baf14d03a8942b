"""SICK S300 and S3000 safety scanners in continuous mode over RS-422."""
