//! Type hashes: frozen, and equal to those that rosidl writes.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

use dermis_msgs::{service_supports, type_supports};

/// Name and hash of every type, in order of name.
fn hashes() -> BTreeMap<&'static str, &'static str> {
    let messages = type_supports().iter().map(|support| (support.name, support.hash));
    messages.chain(service_supports().iter().map(|support| (support.name, support.hash))).collect()
}

/// A changed hash cuts off every peer that was built before, without a word. Where a change of ours is meant, every
/// robot and every client is built again.
#[test]
#[expect(clippy::too_many_lines, reason = "one table")]
fn hashes_are_frozen() {
    let mut table = String::new();
    for (name, hash) in hashes() {
        writeln!(table, "{name} {hash}").unwrap();
    }
    insta::assert_snapshot!(table, @"
    action_msgs/msg/GoalInfo RIHS01_6398fe763154554353930716b225947f93b672f0fb2e49fdd01bb7a7e37933e9
    action_msgs/srv/CancelGoal RIHS01_573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a
    action_msgs/srv/CancelGoal_Request RIHS01_3d3c84653c1f96918086887e1dcb236faec88b81a5b14fd4cf4840065bcdf8af
    action_msgs/srv/CancelGoal_Response RIHS01_35e682cf3f510e83c70a82a4aac888496dedee56773bf9d8e5e0aa81f9e1c960
    builtin_interfaces/msg/Duration RIHS01_e8d009f659816f758b75334ee1a9ca5b5c0b859843261f14c7f937349599d93b
    builtin_interfaces/msg/Time RIHS01_b106235e25a4c5ed35098aa0a61a3ee9c9b18d197f398b0e4206cea9acf9c197
    dermis_msgs/msg/BodyContact RIHS01_9c707516983cefb8a7e14982e531a492d09a1125df387de9a1b809ec51e9aa61
    dermis_msgs/msg/BodyContacts RIHS01_0ee3d2a8fd308d99d5b6c4f5650f4319c5e4a4f03dd5a7cf9dc86308b8a697bb
    dermis_msgs/msg/Contact RIHS01_95b872787a5247f1b36bc15a6e1bd883439a37103033407b9bdeda5521755be9
    dermis_msgs/msg/ContactArray RIHS01_7305c0bc654021584c0bc20daacea2d6d9c533fae84069dd5d2611414e07706c
    dermis_msgs/msg/DisplacementMap RIHS01_597de52dfe58b90f371fc056cea95666dfe364b621e86fa5c1f682efc3925984
    dermis_msgs/msg/ForceMap RIHS01_46f52096a2921de9ce620d2d2e4c4904866c5b0522f77b3371d352711afa8d6d
    dermis_msgs/msg/Indentation RIHS01_ccd1474b4555624a2f0bf2e12209e781b7ef3409683e3e8f9433b08c0d55d788
    dermis_msgs/msg/IndentationContact RIHS01_7b0e8f9f6011343472b08f0d26268b8f9ea9a332e76d0ad706916141559fed48
    dermis_msgs/msg/LinkWrench RIHS01_7c9e35f76264e281a5ce043b13d1cbc191459072dccdd6ed33a00fd951bc7673
    dermis_msgs/msg/SkinGeometry RIHS01_20056e9bcc62d7519476bdb676127248bb54e48d478f40a1095ffdae0e02bac8
    dermis_msgs/msg/SkinHealth RIHS01_48e90be26a5f02e1f23e9a685ea51b5a8eedb06886c92f308d81c2b966f2671c
    dermis_msgs/msg/TaxelFrame RIHS01_20c4e08a9dc035d7a4cad142d71fb237d393400211c0ac48f8aab619f152ea56
    dermis_msgs/srv/LoadModel RIHS01_fffacc47299a7bf03e57aef27575da186543b6bff4ffccabab029e8b825382d9
    dermis_msgs/srv/LoadModel_Request RIHS01_3e2b24d3c598b1653c7050eb581970d6ee86f5e9fcacb07677d16ef3223f00fa
    dermis_msgs/srv/LoadModel_Response RIHS01_cd84cfa7b97a506031fc9858fc3607e50e9e6cc2112361ece2a7f5e85f084a12
    diagnostic_msgs/msg/DiagnosticArray RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e
    diagnostic_msgs/msg/DiagnosticStatus RIHS01_b0e3e692ea2d54a8af2f4ef1930e81556a2db55216b771f8a7d2724ed47bf0e4
    diagnostic_msgs/msg/KeyValue RIHS01_d68081eaa540288c5440753baecef0c4e16e81a5f78ad68902ded5100413bb42
    geometry_msgs/msg/Point RIHS01_6963084842a9b04494d6b2941d11444708d892da2f4b09843b9c43f42a7f6881
    geometry_msgs/msg/Point32 RIHS01_2fc4db7cae16a4582c79a56b66173a8d48d52c7dc520ddc55a0d4bcf2a4bfdbc
    geometry_msgs/msg/PointStamped RIHS01_4c0296af86e01e562e9e0405d138a01537247580076c58ea38d7923ac1045897
    geometry_msgs/msg/Pose RIHS01_d501954e9476cea2996984e812054b68026ae0bfae789d9a10b23daf35cc90fa
    geometry_msgs/msg/PoseStamped RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8
    geometry_msgs/msg/Quaternion RIHS01_8a765f66778c8ff7c8ab94afcc590a2ed5325a1d9a076ffff38fbce36f458684
    geometry_msgs/msg/Transform RIHS01_beb83fbe698636351461f6f35d1abb20010c43d55374d81bd041f1ba2581fddc
    geometry_msgs/msg/TransformStamped RIHS01_0a241f87d04668d94099cbb5ba11691d5ad32c2f29682e4eb5653424bd275206
    geometry_msgs/msg/Twist RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a
    geometry_msgs/msg/TwistStamped RIHS01_5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64
    geometry_msgs/msg/Vector3 RIHS01_cc12fe83e4c02719f1ce8070bfd14aecd40f75a96696a67a2a1f37f7dbb0765d
    geometry_msgs/msg/Vector3Stamped RIHS01_d4829622288cbb443886e7ea94ea5671a3b1be6bab4ad04224432a65f7d7887a
    geometry_msgs/msg/Wrench RIHS01_018e8519d57c16adbe97c9fe1460ef21fec7e31bc541de3d653a35895677ce52
    geometry_msgs/msg/WrenchStamped RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77
    lifecycle_msgs/msg/State RIHS01_dd2d02b82f3ebc858e53c431b1e6e91f3ffc71436fc81d0715214ac6ee2107a0
    lifecycle_msgs/msg/Transition RIHS01_c65d7b31ea134cba4f54fc867b817979be799f7452035cd35fac9b7421fb3424
    lifecycle_msgs/msg/TransitionDescription RIHS01_c5f1cd4bb1ad2ba0e3329d4ac7015c52a674a72c1faf7974c37a33f4f6048b28
    lifecycle_msgs/msg/TransitionEvent RIHS01_d5f8873a2f0146498f812d7885c7327ce27e463d36811d8792f35ee38c0d6c38
    lifecycle_msgs/srv/ChangeState RIHS01_356fe34f0475a43acf54542013af4167b0e729f77ea22ffb045c6ad8e20668e5
    lifecycle_msgs/srv/ChangeState_Request RIHS01_d74c6f524e14cade7b67e7297190360ed749264af300524fc1456f27cc2a553a
    lifecycle_msgs/srv/ChangeState_Response RIHS01_e1ddfed0271fefe63767aa71561926e4d9eac0f1ddf9e71a8873eb46b36deac2
    lifecycle_msgs/srv/GetAvailableStates RIHS01_00a07d79d2207d71e81a8cbc1880e5d924cc16d4688ea8e8e06e443dc8f8aa1d
    lifecycle_msgs/srv/GetAvailableStates_Request RIHS01_c2c0c12de6023822f284929577d4ca2862e0501150010966e8a90b632e4424de
    lifecycle_msgs/srv/GetAvailableStates_Response RIHS01_223e0dd5bb8a847ebb9532adaf8b5e2a97e6e68e79faeaabd81a45fb32925bd1
    lifecycle_msgs/srv/GetAvailableTransitions RIHS01_59b7ecefce0982a8a844b9f2c4f14764c1c4543cc55e72924e2aa4adad83e9bc
    lifecycle_msgs/srv/GetAvailableTransitions_Request RIHS01_52a73c0b5d7489bee0df6ddb0aec45c41289d223ff225b58fe11d859ac8109a6
    lifecycle_msgs/srv/GetAvailableTransitions_Response RIHS01_4711339461aadf02bcfff797a198de911f885074bd3f2fe9f7b677ef87f0741c
    lifecycle_msgs/srv/GetState RIHS01_800a0a5aae599782b02932de0caf563f6dc4e7e94b794eadde075ba2cbef9795
    lifecycle_msgs/srv/GetState_Request RIHS01_77a9c844e7975f15bc2221e8bbebafc4d118afb78c7f7071eef91f83f940f2f6
    lifecycle_msgs/srv/GetState_Response RIHS01_fe249babab472e42cb5653b5d6a6b0c42a003b0fdfb84851aea3fde08760b4f5
    rcl_interfaces/msg/FloatingPointRange RIHS01_e6af23a23c177fee5f3075c8b1e435162a9b63c863d78c06017460b49684262d
    rcl_interfaces/msg/IntegerRange RIHS01_f7b7fdc0f65f07702e099218e13288c3963bcb9345bde78b560e6cd19800fc5a
    rcl_interfaces/msg/ListParametersResult RIHS01_237ae3428413dcbcfb452b510c42355f3a2b021dc091afa3e18526d57022f1cd
    rcl_interfaces/msg/Log RIHS01_e28ce254ca8abc06abf92773b74602cdbf116ed34fbaf294fb9f81da9f318eac
    rcl_interfaces/msg/Parameter RIHS01_ddfe6442cffc462317adb5c92536a7b6dd55858c5c3e1e328165a6b73c2831af
    rcl_interfaces/msg/ParameterDescriptor RIHS01_52175dbfda6c51153101d33d2a9da05743f66f02d5ab2ca9ec4709b46b73d704
    rcl_interfaces/msg/ParameterEvent RIHS01_043e627780fcad87a22d225bc2a037361dba713fca6a6b9f4b869a5aa0393204
    rcl_interfaces/msg/ParameterType RIHS01_df29ed057a834862187be24dd187d981790ff3ea6502f4cd27b432cbc42c6d46
    rcl_interfaces/msg/ParameterValue RIHS01_115fc089a387e23c7ecd3525c9189c379109119d6ab82e8dfbde0fdf6a7f9b68
    rcl_interfaces/msg/SetParametersResult RIHS01_cfcc0fb0371ee5159b403960ef4300f8f9d2f1fd6117c8666b7f9654d528a9b1
    rcl_interfaces/srv/DescribeParameters RIHS01_845b484d71eb0673dae682f2e3ba3c4851a65a3dcfb97bddd82c5b57e91e4cff
    rcl_interfaces/srv/DescribeParameters_Request RIHS01_05dd1c2bc87dec2627105c8070d6f9725c781a4f2ab852975bf105462b82b644
    rcl_interfaces/srv/DescribeParameters_Response RIHS01_ad6747319613c6131589e062e095b469a46cc764f7d0f12a001a49e6cd893995
    rcl_interfaces/srv/GetParameterTypes RIHS01_da199c878688b3e530bdfe3ca8f74cb9fa0c303101e980a9e8f260e25e1c80ca
    rcl_interfaces/srv/GetParameterTypes_Request RIHS01_87d7ec5ef545d4daa289d500025d31fb2437bc8b8365ca367161c4dac4be33fd
    rcl_interfaces/srv/GetParameterTypes_Response RIHS01_ac1335dce67c478e669434f6ac2fbff34fcd529580f272d3006785ba8b54e47f
    rcl_interfaces/srv/GetParameters RIHS01_bf9803d5c74cf989a5de3e0c2e99444599a627c7ff75f97b8c05b01003675cbc
    rcl_interfaces/srv/GetParameters_Request RIHS01_135a9e1c3d7cebef792f6687d7ddf99949b21a0bd9a320d863a9110a3f5cf4d6
    rcl_interfaces/srv/GetParameters_Response RIHS01_9fa773b46e39cc5d02db6224d8fd520bb9caeeffc2b27c96c1e59431baba9f2a
    rcl_interfaces/srv/ListParameters RIHS01_3e6062bfbb27bfb8730d4cef2558221f51a11646d78e7bb30a1e83afac3aad9d
    rcl_interfaces/srv/ListParameters_Request RIHS01_a1b0b5d6b967a5b8ac5bc8563c3ea678f349e312a6a4967227c5a96bc5ce38df
    rcl_interfaces/srv/ListParameters_Response RIHS01_31b937b82de3612426be79f231e386259f97e8dc843e3f2845288b4bfa296bdd
    rcl_interfaces/srv/SetParameters RIHS01_56eed9a67e169f9cb6c1f987bc88f868c14a8fc9f743a263bc734c154015d7e0
    rcl_interfaces/srv/SetParametersAtomically RIHS01_0e192ef259c07fc3c07a13191d27002222e65e00ccec653ca05e856f79285fcd
    rcl_interfaces/srv/SetParametersAtomically_Request RIHS01_db0bd950ed5ed867a0e90b225e44dea382d762c0762ff3e0ee842190042a59e5
    rcl_interfaces/srv/SetParametersAtomically_Response RIHS01_31b1a38c5b0b9d893ee24da45f69638f4561c78461d82d52750f429b534502b8
    rcl_interfaces/srv/SetParameters_Request RIHS01_130d46386b7e84ea9ecf60608a4d83cbe5e5cb7c6cc5b712b7a4e3a6c254e932
    rcl_interfaces/srv/SetParameters_Response RIHS01_7a0e8140a0b8d98308fa81a5403a766e610af29a239caf54b7553227906fc266
    rosgraph_msgs/msg/Clock RIHS01_692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564
    sensor_msgs/msg/CameraInfo RIHS01_b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275
    sensor_msgs/msg/CompressedImage RIHS01_15640771531571185e2efc8a100baf923961a4d15d5569652e6cb6691e8e371a
    sensor_msgs/msg/Image RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47
    sensor_msgs/msg/Imu RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b
    sensor_msgs/msg/JointState RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e
    sensor_msgs/msg/PointCloud2 RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5
    sensor_msgs/msg/PointField RIHS01_5c6a4750728c2bcfbbf7037225b20b02d4429634732146b742dee1726637ef01
    sensor_msgs/msg/RegionOfInterest RIHS01_ad16bcba5f9131dcdba6fbded19f726f5440e3c513b4fb586dd3027eeed8abb1
    service_msgs/msg/ServiceEventInfo RIHS01_41bcbbe07a75c9b52bc96bfd5c24d7f0fc0a08c0cb7921b3373c5732345a6f45
    std_msgs/msg/Bool RIHS01_feb91e995ff9ebd09c0cb3d2aed18b11077585839fb5db80193b62d74528f6c9
    std_msgs/msg/ColorRGBA RIHS01_77a7a5b9ae477306097665106e0413ba74440245b1f3d0c6d6405fe5c7813fe8
    std_msgs/msg/Empty RIHS01_20b625256f32d5dbc0d04fee44f43c41e51c70d3502f84b4a08e7a9c26a96312
    std_msgs/msg/Float32 RIHS01_7170d3d8f841f7be3172ce5f4f59f3a4d7f63b0447e8b33327601ad64d83d6e2
    std_msgs/msg/Float64 RIHS01_705ba9c3d1a09df43737eb67095534de36fd426c0587779bda2bc51fe790182a
    std_msgs/msg/Header RIHS01_f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01
    std_msgs/msg/Int32 RIHS01_b6578ded3c58c626cfe8d1a6fb6e04f706f97e9f03d2727c9ff4e74b1cef0deb
    std_msgs/msg/String RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18
    std_msgs/msg/UInt8 RIHS01_6138bd83d8c3569cb80a667db03cfc1629f529fee79d944c39c34e352e72f010
    std_srvs/srv/SetBool RIHS01_abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a
    std_srvs/srv/SetBool_Request RIHS01_c62fbb99d94e1b25e8ef9e109f9581956bb1b3361a45a4e5810c36a90d29932e
    std_srvs/srv/SetBool_Response RIHS01_d0814e7f7b4880ab77e9c57426c7aa1562ab69f11eef8e2e968812f9cbd0b059
    std_srvs/srv/Trigger RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f
    std_srvs/srv/Trigger_Request RIHS01_d010825374ce8918e72bfd826c82603e60f45419e932ea976f807b74a863a199
    std_srvs/srv/Trigger_Response RIHS01_2d946c21e2fc3f1e9ca6986a8191d85fcc70097a8bb7771a053564bc47009cdf
    tf2_msgs/msg/TFMessage RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087
    unique_identifier_msgs/msg/UUID RIHS01_1b8e8aca958cbea28fe6ef60bf6c19b683c97a9ef60bb34752067d0f2f7ab437
    visualization_msgs/msg/Marker RIHS01_45b13ccf791f225962bf74e746f9644518855d783a6f42ba0cc14fde2b4f3ce0
    visualization_msgs/msg/MarkerArray RIHS01_86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf
    visualization_msgs/msg/MeshFile RIHS01_7710ece15a148fb7c9b546364cfb215bb06098087bd6394fe5b73a493508f8c4
    visualization_msgs/msg/UVCoordinate RIHS01_f27f7ed21fe360c6066944f856b801a0c0d1e94e815b6886444b42d90b196a26
    ");
}

/// `DERMIS_ROS_PREFIX` is a ROS 2 installation that dermis_msgs is built into: `/opt/ros/kilted`, a colcon workspace's
/// `install`, or a Python environment with ROS 2 wheels. Several prefixes are separated by `:`.
#[test]
fn hashes_are_those_of_rosidl() {
    let Ok(prefixes) = std::env::var("DERMIS_ROS_PREFIX") else {
        println!("skipped: DERMIS_ROS_PREFIX names no ROS 2 installation to compare with");
        return;
    };
    let mut compared = 0;
    let mut missing = Vec::new();
    for (name, hash) in hashes() {
        // Requests and responses are described in the file of their service.
        let file = name.trim_end_matches("_Request").trim_end_matches("_Response");
        let found = prefixes.split(':').find_map(|prefix| {
            std::fs::read_to_string(Path::new(prefix).join("share").join(format!("{file}.json"))).ok()
        });
        let Some(text) = found else {
            missing.push(name);
            continue;
        };
        let json: serde_json::Value = serde_json::from_str(&text).unwrap();
        let theirs = json["type_hashes"]
            .as_array()
            .unwrap()
            .iter()
            .find(|entry| entry["type_name"] == name)
            .unwrap_or_else(|| panic!("{file}.json has no hash of {name}"));
        assert_eq!(theirs["hash_string"], hash, "{name}");
        compared += 1;
    }
    println!("{compared} hashes are equal; not installed there: {missing:?}");
    assert_eq!(missing, [""; 0], "not installed in {prefixes}");
}
